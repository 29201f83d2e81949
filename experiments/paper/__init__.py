"""The paper's protocol as data, and its tables."""
