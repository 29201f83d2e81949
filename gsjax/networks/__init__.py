"""Networks of users: their records, their graphs, and their use."""
