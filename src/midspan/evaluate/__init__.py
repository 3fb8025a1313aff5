"""How good a result is: against a reference, against its own error band, against the theoretical bound."""
