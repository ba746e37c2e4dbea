"""The vehicle: models, tyres, actuators, and their integration in time."""
