"""Studies of a scene: what accuracy costs in time. They start runs and read their folders; no solver knows of them."""
