"""Sources, clip tables, mixtures and samplers for fine-tuning."""
