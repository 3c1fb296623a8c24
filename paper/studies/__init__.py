"""The studies of the paper: functions, and their text in a file for each study."""
