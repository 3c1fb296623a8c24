"""The live page: an arm drawn from plain arrays in the browser, with controls. Knows no ROS."""
