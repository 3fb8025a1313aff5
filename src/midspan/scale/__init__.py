"""Many recordings as one: campaigns, on one machine or on several."""
