"""The Rao-Blackwellized particle filter over semantic maps (section 3.2)."""
