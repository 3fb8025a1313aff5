"""The live shell: what runs points on streams, keeps what they give, and says how they stand."""
