"""The ideal velocity loop over one step, exactly: no integrator, no step error.

    x = (omega - r, z),   dx/dt = M x + (a, q),   M = [[-p, i], [-1, 0]]
    x(h) = E x + S (a, q),   theta(h) = theta + r h + (1, 0) (S x + D (a, q))
    E = exp(M h),   S = int_0^h exp(M t) dt,   D = int_0^h (h - t) exp(M t) dt

p = K_P K_T / J, i = K_I K_T / J; r command, z integral of the velocity error; a acceleration and
q integrator rate beyond the ideal loop's, constant over the step. p = i = 0 coasts.
"""


def propagator(
    p: float, i: float, h: float
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """(E11, E12, E21, E22, S11, S12, S21, S22, D11, D12), by the exponential's series.

    By Cayley and Hamilton M^2 = -p M - i, so that each term is one number times 1 and one times
    M. Sixteen terms are exact to rounding for h (p + sqrt(i)) <= 0.5; it ends where terms are lost
    in rounding, at once for h = 0.
    """
    one, m = 1.0, 0.0
    e0, e1, s0, s1, d0, d1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    part = h
    for k in range(16):
        then = h / (k + 2)
        e0 += one
        e1 += m
        s0 += one * part
        s1 += m * part
        d0 += one * part * then
        d1 += m * part * then
        one, m = -i * m * part, (one - p * m) * part
        part = then
        if abs(one) < 1e-18 and abs(m) <= 1e-18 * e1:
            break
    return (
        *(e0 - p * e1, i * e1, -e1, e0),
        *(s0 - p * s1, i * s1, -s1, s0),
        *(d0 - p * d1, i * d1),
    )
