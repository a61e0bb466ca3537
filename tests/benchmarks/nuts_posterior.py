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

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import numpyro  # noqa: E402
import numpyro.distributions as dist  # noqa: E402
from numpyro.infer import MCMC, NUTS  # noqa: E402

ROW = np.array([0, 0, 0, 0, 1, 1, 1, 2, 2, 3])
COLUMN = np.array([0, 1, 2, 3, 1, 2, 3, 2, 3, 3])
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

    def model():
        log_scales = numpyro.sample("log_scales", dist.ImproperUniform(dist.constraints.real_vector, (), (channels,)))
        raw = numpyro.sample("raw", dist.ImproperUniform(dist.constraints.real_vector, (), (d,)))
        if cone:
            entries, jacobian = bodies(raw[: 10 * count].reshape(count, 10))
            linear = data["from_entries"] @ jnp.concatenate([entries, raw[10 * count :] * data["effect_scale"]])
            gap = data["prior"] @ (linear[: 10 * count] - data["prior_mean"])
            numpyro.factor("prior", jacobian - 0.5 * jnp.sum(gap**2))
        else:
            linear = data["centre"] + raw * data["scale"]
        numpyro.deterministic("linear", linear)
        numpyro.factor("likelihood", log_likelihood(data["to_columns"] @ linear, log_scales))

    start = {"log_scales": jnp.zeros(channels), "raw": data["start"]}
    kernel = NUTS(model, dense_mass=True, init_strategy=numpyro.infer.init_to_value(values=start))
    mcmc = MCMC(kernel, num_warmup=options.warm_up, num_samples=options.draws, num_chains=options.chains,
                chain_method="sequential", progress_bar=False)  # fmt: skip
    begin = time.process_time()
    mcmc.warmup(jax.random.PRNGKey(0), extra_fields=("num_steps",))
    warm = time.process_time() - begin
    # One short call compiles what sampling needs; it does not count.
    mcmc.run(jax.random.PRNGKey(1), extra_fields=("num_steps",))
    begin = time.process_time()
    mcmc.run(jax.random.PRNGKey(2), extra_fields=("num_steps",))
    samples = mcmc.get_samples(group_by_chain=True)
    linear = np.asarray(samples["linear"])
    seconds = time.process_time() - begin
    draws = np.concatenate([linear, np.exp(np.asarray(samples["log_scales"]))], axis=2)
    np.savez(options.out, draws=draws)
    steps = float(np.mean(np.asarray(mcmc.get_extra_fields()["num_steps"])))
    versions = {"numpyro": numpyro.__version__, "jax": jax.__version__}
    print(json.dumps({"seconds": seconds, "warm_up_s": warm, "steps": steps, **versions}))


if __name__ == "__main__":
    main()
