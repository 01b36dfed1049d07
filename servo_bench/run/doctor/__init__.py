"""What is wrong between this computer and the rig: host, wire, drive, encoder, and a slow move."""
