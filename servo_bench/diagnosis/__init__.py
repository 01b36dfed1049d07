"""What the rig's simulation gets wrong. For now: which nominal value must change, and the gain."""
