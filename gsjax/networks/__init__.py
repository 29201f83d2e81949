"""Networks that users bring: their records, their graphs, and what they are asked for."""
