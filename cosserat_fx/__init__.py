"""Granular bodies against rough walls: hypoplastic Cosserat continua with DOLFINx.

Importing this package needs no DOLFINx. The modules that do need it take it from ``cosserat_fx._compat``, which tells
how to install it where it is missing.
"""

__version__ = "0.1.0"
