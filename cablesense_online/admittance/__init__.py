"""Moving an arm away from contacts, and an elastic wall to touch it with: no rclpy here."""
