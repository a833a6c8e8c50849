"""Weak forms of the Cosserat continuum: UFL and nothing else.

``kinematics`` says what strains, ``balance`` what resists, ``stabilization`` what reduced integration needs. What
happens on a boundary has a file each: ``traction``, ``pressure``, ``couple``, ``walls`` and the ``ties`` that hold them
where they are oblique; ``weight`` acts in the body.
"""
