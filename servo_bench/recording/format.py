"""Names in a recording file, and the bounds within which a stranger's file is read.

The prose is in docs/recording-format.md. A bound is there so that a few bytes cannot ask for all
the memory there is; each is far above what an honest recording needs.
"""

from servo_bench.recording.recording import FAST_FIELDS, SAMPLE_FIELDS

DOCUMENT = "docs/recording-format.md"
FORMAT_VERSION = 1

SAMPLES_TOPIC = "/samples"
FAST_TOPIC = "/fast_samples"
EVENTS_TOPIC = "/events"
CONFIG_TOPIC = "/config"
MEASURED_TOPIC = "/measured"

FORMAT_METADATA = "servo_bench.recording"
EXPERIMENT_METADATA = "servo_bench.experiment"
RIG_METADATA = "servo_bench.rig"
PLANT_METADATA = "servo_bench.plant"
PROVENANCE_METADATA = "servo_bench.provenance"
ALIGNMENT_METADATA = "servo_bench.alignment"
RECOVERY_METADATA = "servo_bench.recovery"

SAMPLE_KINDS = dict(SAMPLE_FIELDS)
FAST_KINDS = dict(FAST_FIELDS)
REQUIRED_FIELDS = ("slot", "phase", "chip", "velocity_command_rad_s")
"""What was played. Besides these a recording holds at least one of `MEASURED_FIELDS`."""
MEASURED_FIELDS = ("motor_position_rad", "motor_velocity_rad_s", "load_angle_rad")

MIB = 1 << 20
MAX_FILE_BYTES = 1024 * MIB
"""A day at 8 ms is 0.9 GiB before compression."""
MAX_CHUNK_BYTES = 64 * MIB
"""Of one chunk, unpacked. Writers' defaults are between 0.75 and 4 MiB."""
MAX_UNPACKED_BYTES = 4096 * MIB
"""Of all chunks together; they are unpacked one at a time."""
MAX_KEPT_BYTES = 1024 * MIB
"""Of the samples and events that a recording is made of."""
MAX_JSON_BYTES = 16 * MIB
"""Of one JSON message: parsed, it takes some twenty times as much."""
