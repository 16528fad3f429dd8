"""Networks that correct rollouts, and the learned rival without labels."""
