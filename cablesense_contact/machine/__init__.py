"""What readings of a machine that MuJoCo describes say of contacts."""
