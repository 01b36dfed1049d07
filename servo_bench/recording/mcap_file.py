"""Recordings as MCAP files: write one, read one, save a cut one. See docs/recording-format.md."""

from servo_bench.recording.reader import load
from servo_bench.recording.recover import Recovered, recover
from servo_bench.recording.writer import RecordingWriter

__all__ = ["RecordingWriter", "Recovered", "load", "recover"]
