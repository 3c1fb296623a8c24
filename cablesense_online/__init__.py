"""What runs beside a live arm, without ROS: estimation, CAN, sensors, control, replay, page."""
