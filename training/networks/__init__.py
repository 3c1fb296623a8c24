"""The networks: raw tension differences in, contacts and forces with their uncertainty out."""
