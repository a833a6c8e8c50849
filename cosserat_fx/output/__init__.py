"""What a run shows of a body: rows, fields, band metrics and figures, by kind of body."""
