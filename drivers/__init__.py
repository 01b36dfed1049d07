"""Masters on a wire: a drive that is commanded every period and the encoder that answers.

Knows neither the bench nor the simulation. `drivers.axis` is the vocabulary, one package per
protocol implements it, `drivers.errors` says what can go wrong.
"""
