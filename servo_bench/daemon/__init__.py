"""The daemon that a lab lives with: it owns a rig, plays one run at a time, and serves a page.

Three processes, so that none can take another down: the web side (HTTP, WebSocket, queue), the
runner of one run (session and recording), and the bus loop. They share the slot table's memory
and one socket; docs/daemon.md draws them, and the states that a run passes.
"""
