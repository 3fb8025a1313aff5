"""The page's server: REST, live rows and access over a store, in a process of its own next to the engine's."""
