"""Acceptance: a plan with limits, a run, and a judgement for machines and for people.

plan       Plan: what is played, and what must come out
judge      judge(plan, recording) -> Judgement, finding by finding
verdict    the diagnosis, called in one place
junit      a judgement as JUnit XML
page       a judgement, or a failed test's runs, as one HTML page
"""
