"""OpenSCENARIO XML 1.x (ASAM): scenarios that people wrote, carried out on OpenDRIVE roads, without controllers."""
