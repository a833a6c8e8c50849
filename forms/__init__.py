"""Weak forms of the Cosserat continuum, in pure UFL."""
