"""Nodes, launch files, the demo and the verbs: all that needs rclpy or starts nodes."""
