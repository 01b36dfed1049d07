"""How the name of a parameter may end: its SI unit, or a word for a pure number."""

SUFFIXES = (
    *("_nm", "_rad", "_rad_s", "_s", "_a", "_v", "_kg_m2", "_per_a", "_hz", "_k"),
    *("_nm_s_per_rad", "_rad_per_nm", "_nm_per_rad", "_s_per_rad", "_s2_per_rad", "_m"),
    *("_a_s_per_rad", "_nm_s2_per_rad2", "_per_k", "_per_rad", "_per_nm", "_s_per_m"),
    *("_per_s", "_per_a2"),
    *("order", "fraction", "ratio", "exponent", "probability", "seed", "scale", "count"),
)
