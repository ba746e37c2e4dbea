"""Launching two-stage SFT: the public Alpamayo recipes on a machine or a cluster, and the toy here."""
