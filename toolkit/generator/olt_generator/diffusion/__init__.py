"""The learned view engine: Wan2.1-VACE conditioned on rays, warps and other views; see `conditioned_model.py` first."""
