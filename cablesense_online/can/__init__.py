"""The real arm's tensions from a CAN bus: frames in, whole samples out, every fault by name.

Nothing here imports rclpy.
"""
