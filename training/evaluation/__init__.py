"""Figures of merit, and what they are measured on."""
