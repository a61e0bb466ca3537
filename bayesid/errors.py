"""Exceptions and warnings; each says what is wrong, where, and what to do about it."""


class BayesidError(Exception):
    """Root of every exception that bayesid raises on purpose."""


class InputError(BayesidError):
    """Bad input or usage; the message is one line: which file, which key or column, which value, what to do."""


class EstimationError(BayesidError):
    """The input was fine but the computation failed; the message says what usually causes that."""


class BayesidWarning(UserWarning):
    """Something in the data or the result that the user should know, but that stops nothing."""
