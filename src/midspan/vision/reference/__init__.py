"""Reference frames that follow a changing appearance: the published rule, and key frames that overlap."""
