"""Nodes, launch files and the demo: all that needs rclpy or starts nodes."""
