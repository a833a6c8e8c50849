"""The initial void ratio: from zones, files and random fields to the quadrature points."""
