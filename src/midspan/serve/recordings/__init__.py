"""The page over recordings of this machine, for the person at it: `midspan open`."""
