"""Meshes from files, and what is asked of a mesh: checks, sizes, normals."""
