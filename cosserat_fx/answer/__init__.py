"""A run checks its own answer: equilibrium, mass, admissible range, energy put in and dissipated."""
