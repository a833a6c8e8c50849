"""What is inside a checkpoint, how it is laid out in its file, and which scene it belongs to."""
