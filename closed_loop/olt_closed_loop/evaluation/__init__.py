"""Policies over suites of scenes: the gate, closed-loop runs, score tables."""
