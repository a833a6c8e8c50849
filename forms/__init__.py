"""Weak forms of the Cosserat continuum: UFL and nothing else.

``kinematics`` says what strains, ``balance`` what resists, ``loads`` and ``walls`` what drives.
"""
