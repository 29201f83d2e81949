"""Networks that users bring: their records, their graphs, and their use."""
