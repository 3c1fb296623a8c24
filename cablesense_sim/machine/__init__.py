"""Any cable-driven machine that MuJoCo describes: its file, its statics, what is uncertain."""
