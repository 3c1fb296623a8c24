"""The `cablesense` command: a thin file for each verb, which imports its room when it runs."""
