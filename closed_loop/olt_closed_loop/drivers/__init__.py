"""AlpaSim's services, both ways: its drivers drive here, and policies, vehicle and controller serve there."""

import os

# Policies get processes by fork (`simulation.policy_process`), which need no gRPC: its handlers of forks, which run in
# them while other threads are at work, can hang them. It reads this when it is first imported.
os.environ["GRPC_ENABLE_FORK_SUPPORT"] = "0"
