"""AlpaSim's services, both ways: its drivers drive here, and policies, vehicle and controller serve there."""
