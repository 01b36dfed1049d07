"""CANopen masters: a CiA 402 drive and a CiA 406 encoder on one bus."""
