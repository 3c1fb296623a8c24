"""Nodes, launch files, the page and the `cablesense` command: the only room with rclpy."""
