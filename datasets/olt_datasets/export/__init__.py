"""Training data in the layouts that public recipes read: PhysicalAI-AV and LeRobot."""
