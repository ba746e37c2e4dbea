"""The definitions `alpasim@...`: the values of AlpaSim's own evaluation in its public versions, quirks included.

`scores.score_as_alpasim` is the entry. The quirks are kept on purpose: a score is comparable only with the same ones.
`scoring.definitions` says what the definition `strict` does instead.
"""
