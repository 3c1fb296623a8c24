"""Figures of merit, and the data that they are measured on."""
