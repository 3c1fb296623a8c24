"""Commissioning of tension sensors: check their statistics, and calibrate scale and zero."""
