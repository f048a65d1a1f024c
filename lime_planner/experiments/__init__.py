"""The paper's experiments: tables, statistics and figures, and exact references to judge planners by."""
