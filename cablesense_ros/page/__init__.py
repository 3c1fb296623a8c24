"""The live page: an arm drawn from plain arrays in the browser, and the controls that push and move it. Knows no ROS."""
