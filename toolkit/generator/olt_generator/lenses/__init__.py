"""Camera models, and images turned from one camera into another in the same place."""
