"""numpyro's NUTS on a posterior of bayesid, in an environment of its own; no bayesid here.

``python nuts_posterior.py problem.npz draws.npz --rows`` reads the model and writes draws and times. The model is the
same: whitened rows, unknown scales with Jeffreys' prior, and either a flat prior on the base parameters or the nominal
one on log-Cholesky factors of the bodies. ``--rows`` gives it the rows themselves, as a user would write it; without, it
gets bayesid's factors, so that a gradient costs nothing in the number of rows.
"""

from __future__ import annotations

import argparse
import json
import time

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from numpyro.infer import NUTS

numpyro.enable_x64()

ROW = np.array([0, 0, 0, 0, 1, 1, 1, 2, 2, 3])
COLUMN = np.array([0, 1, 2, 3, 1, 2, 3, 2, 3, 3])
#: Draws of one compiled call.
PIECE = 50
ABOVE = (np.array([0, 0, 0, 1, 1, 2]), np.array([1, 2, 3, 2, 3, 3]))


def bodies(theta):
    """Entries of each body's matrix and the log Jacobian, of log-Cholesky parameters (b, 10)."""
    u = jnp.zeros((len(theta), 4, 4))
    u = u.at[:, np.arange(4), np.arange(4)].set(jnp.exp(theta[:, :4]))
    u = u.at[(slice(None), *ABOVE)].set(theta[:, 4:])
    m = u @ jnp.swapaxes(u, 1, 2)
    return m[:, ROW, COLUMN].ravel(), jnp.sum(theta[:, :4] @ jnp.array([2.0, 3.0, 4.0, 5.0]))


def main() -> None:
    """Sample and write."""
    parser = argparse.ArgumentParser()
    parser.add_argument("problem")
    parser.add_argument("out")
    parser.add_argument("--rows", action="store_true")
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--warm-up", type=int, default=1000)
    parser.add_argument("--chains", type=int, default=4)
    parser.add_argument("--target", type=float, default=0.8, help="acceptance that the step size is adapted to")
    parser.add_argument("--depth", type=int, default=10, help="at most 2^depth steps a draw")
    parser.add_argument("--adapt-mass", action="store_true", help="adapt the mass matrix instead of keeping the problem's")
    options = parser.parse_args()
    data = {key: jnp.asarray(value) for key, value in np.load(options.problem).items()}
    count, cone = int(data["bodies"]), "prior" in data
    d = data["to_columns"].shape[1]
    channels = len(data["counts"])

    def log_likelihood(columns, log_scales):
        if options.rows:
            residual = data["white"][:, :, -1] - data["white"][:, :, :-1] @ columns
            return jnp.sum(dist.Normal(0.0, jnp.exp(log_scales)).log_prob(residual))
        squares = jnp.sum((data["factors"][:, :, :-1] @ columns - data["factors"][:, :, -1]) ** 2, axis=1)
        return -jnp.sum(data["counts"] * log_scales + 0.5 * squares * jnp.exp(-2 * log_scales))

    def linear_of(raw):
        if not cone:
            return data["centre"] + raw * data["scale"], 0.0
        entries, jacobian = bodies(raw[: 10 * count].reshape(count, 10))
        linear = data["from_entries"] @ jnp.concatenate([entries, raw[10 * count :] * data["effect_scale"]])
        gap = data["prior"] @ (linear[: 10 * count] - data["prior_mean"])
        return linear, jacobian - 0.5 * jnp.sum(gap**2)

    def model():
        log_scales = numpyro.sample("log_scales", dist.ImproperUniform(dist.constraints.real_vector, (), (channels,)))
        raw = numpyro.sample("raw", dist.ImproperUniform(dist.constraints.real_vector, (), (d,)))
        linear, prior = linear_of(raw)
        numpyro.factor("prior", prior)
        numpyro.factor("likelihood", log_likelihood(data["to_columns"] @ linear, log_scales))

    kernel = NUTS(model, dense_mass=True, inverse_mass_matrix={("log_scales", "raw"): data["mass"]},
                  adapt_mass_matrix=options.adapt_mass, target_accept_prob=options.target,
                  max_tree_depth=options.depth)  # fmt: skip

    def step(state, _):
        state = kernel.sample(state, (), {})
        shown = {"linear": linear_of(state.z["raw"])[0], "scales": jnp.exp(state.z["log_scales"])}
        return state, shown | {"steps": state.num_steps, "divergent": state.diverging, "acceptance": state.accept_prob}

    @jax.jit
    def advance(state):
        return jax.lax.scan(step, state, None, length=PIECE)

    def run(state, count):
        begin, pieces = time.process_time(), []
        for _ in range(count // PIECE):
            state, shown = advance(state)
            pieces.append({key: np.asarray(value) for key, value in shown.items()})
        return state, {key: np.concatenate([p[key] for p in pieces]) for key in pieces[0]}, time.process_time() - begin

    warm_up, seconds, chains = 0.0, 0.0, []
    for k in range(options.chains):
        # No bounds, so numpyro's own coordinates are these.
        start = {"log_scales": data["start_scales"][k], "raw": data["start"][k]}
        state = kernel.init(jax.random.PRNGKey(k), options.warm_up, start, (), {})
        if k == 0:
            jax.block_until_ready(advance(state))  # compiles; does not count
        state, _, spent = run(state, options.warm_up)
        warm_up += spent
        _, shown, spent = run(state, options.draws)
        seconds += spent
        chains.append(shown)
    together = {key: np.stack([c[key] for c in chains]) for key in chains[0]}
    np.savez(options.out, draws=np.concatenate([together["linear"], together["scales"]], axis=2))
    told = {key: float(together[key].mean()) for key in ("steps", "divergent", "acceptance")}
    versions = {"numpyro": numpyro.__version__, "jax": jax.__version__}
    print(json.dumps({"seconds": seconds, "warm_up_s": warm_up, **told, **versions}))


if __name__ == "__main__":
    main()
