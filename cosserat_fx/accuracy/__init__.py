"""A run to a requested accuracy: trial runs measure what mesh, steps and local tolerance make of the scene."""
