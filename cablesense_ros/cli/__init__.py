"""The `cablesense` command: one file for each verb, each thin, each importing its room only when it runs."""
