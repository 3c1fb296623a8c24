"""The gap of any robot that MuJoCo can load: its recording against its MJCF or URDF."""
