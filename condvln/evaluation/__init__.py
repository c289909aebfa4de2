"""Episodes and what agents did in them → metrics, intervals, tables."""
