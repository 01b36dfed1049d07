"""The recordings of a folder: an index over the files, and never the truth itself.

run         Run: one line of the catalogue
beside      the small files beside a recording: notes and tags, figures, verdict
reading     what a file and its companions say, as a Run
index       the SQLite file, its schema, and what to do when it is damaged
catalogue   Catalogue(folder): refresh, search, get, annotate, rebuild
retention   which recordings a rule would let go, and letting them go
"""

from servo_bench.catalogue.catalogue import Catalogue, Page, Refreshed
from servo_bench.catalogue.run import Run, run_id

__all__ = ["Catalogue", "Page", "Refreshed", "Run", "run_id"]
