"""The tables of a scene file: their keys, what they allow, and the messages that refuse the rest."""
