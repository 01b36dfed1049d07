"""The daemon's page in a real browser; run by .ci/browser, never by a bare pytest."""
