"""Taking tension sensors into use: are they fit, and what is their scale and zero."""
