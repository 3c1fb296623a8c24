"""What every package stands on: errors, files from outside, installed data, progress."""
