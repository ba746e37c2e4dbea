"""The policy contract: what a driving policy eats and answers, and what a training sample of it is."""
