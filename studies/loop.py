"""The cost of the loop without its simulations: learning a boundary and proposing ten designs, compared with others.

    python studies/loop.py --n 250 1000 4000 16000 50000
    python studies/loop.py --n 500 --peers lbfgs,svgp,aepsych --limit 120

The problem is the failure boundary, with designs of a Latin hypercube of Table 1, labels from the bearing model,
Matérn-5/2, and fresh uniform designs for the scores. Seconds are processor time of this process over all its threads.
activefail is measured

    cold       from scratch;
    warm       with ten designs more than an earlier fit;
    relearned  with new hyperparameters, as a campaign does when it has grown by a twentieth;
    propose    for a batch of ten by entropy.

Learning is timed until the model can predict.

Peers, each with a limit of processor time, learn cold from the same designs. activefail comes first, since its
objective decides when they may stop: the bound plus the log prior of mean and scales, which lbfgs and svgp share.

    lbfgs      GPyTorch's whitened strategy, every point an inducing point (so at most 1,000), by SciPy's L-BFGS;
    svgp       GPyTorch's whitened strategy, 500 inducing points that move, by Adam on batches of 1,000, at a rate of
               0.05 for half of the time and then 0.01;
    aepsych    AEPsych's classifier with a learned output scale, its own objective, and a batch by EAVC.

--inducing compares the posterior with inducing points and the exact one at the same hyperparameters instead, with
inducing points chosen by site precision times unexplained variance, or by the latter alone.

    python studies/loop.py --n 2000 --inducing 250 500 1000

lbfgs and svgp stop when they are within --short nats of activefail's objective. Missing packages are skipped.
"""

import math
import time
import warnings
from functools import partial

import gpytorch
import numpy as np
import torch
from scipy.optimize import minimize
from scipy.special import ndtr
from study import asked, head, timed, uniform
from study import line as row

from activefail.learning.criteria.batch_proposal import propose
from activefail.learning.criteria.criteria import criterion
from activefail.learning.features import feature_map
from activefail.learning.model import fitting
from activefail.learning.model.covariance import JITTER
from activefail.learning.model.inducing import choose, project
from activefail.learning.model.latent import Latent
from activefail.learning.model.sites import Sites, solve_sites
from activefail.learning.model.threads import one_thread
from activefail.seismic.bearing import TABLE_1, simulate
from activefail.seismic.bearing.outcome import FAILURE

FRESH, BATCH, KERNEL = 4000, 10, "matern52"
PRIOR = partial(fitting.outcome_prior, KERNEL)
INDUCING, MINIBATCH = 500, 1000


class Clock:
    """Seconds of processor time since it was made, without those spent paused."""

    def __init__(self):
        self.began, self.left_out = time.process_time(), 0.0

    @property
    def seconds(self):
        return time.process_time() - self.began - self.left_out

    def without(self, function):
        answer, seconds = timed(function)
        self.left_out += seconds
        return answer


def labels(X):
    return np.where(simulate(X, threads=1).outcome == FAILURE, 1.0, -1.0)


def verdict(probit, y):
    """Accuracy and mean log probability of the true side from (mean)/√(1 + sd²) at fresh designs."""
    log_score = np.log(np.clip(ndtr(probit * y), 1e-12, None)).mean()
    return f"{100.0 * np.mean((probit > 0.0) == (y > 0.0)):.2f}", f"{log_score:.4f}"


def line(n, who, objective, seconds, judged=("", ""), note=""):
    row(n, who, f"{seconds:.2f}", "" if objective is None else f"{objective:.1f}", *judged, note)


class Problem:
    """n designs, their labels, and fresh ones."""

    def __init__(self, features, n, seed):
        total = math.ceil((1.0 + fitting.GROWTH) * n) + 1
        self.n, self.features = n, features
        self.X = TABLE_1.latin_hypercube(total, np.random.default_rng([seed, n]))
        np.random.default_rng([seed, n, 1]).shuffle(self.X)
        self.fresh = uniform(FRESH, [seed, 1])
        self.F, self.y = torch.from_numpy(features(self.X)), torch.from_numpy(labels(self.X))
        self.F_fresh, self.y_fresh = features(self.fresh), labels(self.fresh)

    def fit(self, n, warm=None):
        return fitting.fit(self.F[:n], (self.y[:n] > 0.0).double(), PRIOR, warm)

    def judged(self, trained):
        return verdict(Latent(trained).moments(self.F_fresh).standardised, self.y_fresh)


def ours(problem):
    """Print the cost of activefail's learning; returns the objective of the cold fit."""
    n = problem.n

    def ready(*of):
        trained = problem.fit(*of)
        trained.model.moments(problem.F[:1])
        return trained

    cold, seconds = timed(ready, n)
    points = n if cold.inducing is None else len(cold.inducing)
    note = f"{points} points"
    line(n, "cold", cold.objective, seconds, problem.judged(cold), note)
    for who, size in (("warm", n + BATCH), ("relearned", len(problem.y))):
        warm, seconds = timed(ready, size, cold)
        line(n, who, warm.objective, seconds, problem.judged(warm), f"{size - n} designs more")
    rng = np.random.default_rng(1)
    _, seconds = timed(propose, Latent(warm), problem.features, TABLE_1, criterion("entropy"), BATCH, rng)
    line(n, "propose", None, seconds)
    return cold.objective


def inducing_points(problem, numbers):
    n, F, y = problem.n, problem.F[: problem.n], (problem.y[: problem.n] > 0.0).double()
    of = problem.fit(n).prior
    fitting.EXACT = n
    start = Sites(0.2 * y - 0.1, torch.full_like(y, 0.1))
    exact, seconds = timed(lambda: fitting.condition(of, F, y, tolerance=1e-3))
    line(n, "exact", exact.elbo, seconds, problem.judged(exact))
    for name, weights in (("W rest", exact.sites.precision), ("rest", torch.ones(n, dtype=torch.float64))):
        for most in numbers:
            rows, _ = choose(of, F, weights, most=most)
            prior = project(of, F, rows)
            (sites, state), seconds = timed(lambda prior=prior: solve_sites(prior, of.likelihood, y, start, 1e-3))
            fit = fitting.Fit(of, F, y, sites, state.elbo, n, rows)
            note = f"{len(rows)} points, {exact.elbo - fit.elbo:.2f} short"
            line(n, name, fit.elbo, seconds, problem.judged(fit), note)


class Variational(gpytorch.models.ApproximateGP):
    """GPyTorch's model with activefail's covariance and priors."""

    def __init__(self, Z, move):
        q = gpytorch.variational.CholeskyVariationalDistribution(len(Z)).double()
        super().__init__(gpytorch.variational.VariationalStrategy(self, Z, q, move, jitter_val=JITTER))
        self.mean_module = gpytorch.means.ConstantMean().double()
        self.covar_module = PRIOR(Z.shape[1]).covar_module
        # Where ours starts.
        self.covar_module.outputscale = 10.0
        self.covar_module.base_kernel.lengthscale = math.sqrt(Z.shape[1])

    def forward(self, x):
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))

    def log_prior(self):
        scales = [(density, closure(module)) for _, module, density, closure, _ in self.named_priors()]
        of_mean = -0.5 * self.mean_module.constant.squeeze() ** 2
        return of_mean + sum((density.log_prob(scale) + scale.log()).sum() for density, scale in scales)

    def objective(self, F, y, n):
        """Bound plus log prior, estimated from some of n points."""
        expected = gpytorch.likelihoods.BernoulliLikelihood().expected_log_prob((y > 0.0).double(), self(F)).sum()
        return expected * (n / len(y)) - self.variational_strategy.kl_divergence() + self.log_prior()

    def whole(self, F, y):
        with torch.no_grad():
            parts = [self.objective(f, t, len(t)) for f, t in zip(F.split(4000), y.split(4000), strict=True)]
            once = self.log_prior() - self.variational_strategy.kl_divergence()
            return float(sum(parts) - (len(parts) - 1) * once)

    def judged(self, problem):
        self.eval()
        with torch.no_grad():
            parts = [self(f) for f in torch.from_numpy(problem.F_fresh).split(1000)]
            mean, variance = torch.cat([p.mean for p in parts]), torch.cat([p.variance for p in parts])
        return verdict((mean / (1.0 + variance).sqrt()).numpy(), problem.y_fresh)


class DoneError(Exception):
    """A peer has reached the objective, or its time limit."""


def lbfgs(problem, target, limit):
    if problem.n > 1000:
        return
    F, y = problem.F[: problem.n], problem.y[: problem.n]
    model = Variational(F, False).train()
    parameters = [p for p in model.parameters() if p.requires_grad]
    clock, best = Clock(), -math.inf

    def negative(packed):
        nonlocal best
        torch.nn.utils.vector_to_parameters(torch.from_numpy(packed), parameters)
        model.zero_grad()
        value = model.objective(F, y, len(y))
        value.backward()
        best = max(best, float(value.detach()))
        if best > target or clock.seconds > limit:
            raise DoneError
        return -float(value.detach()), -torch.cat([p.grad.reshape(-1) for p in parameters]).numpy()

    with torch.no_grad():  # GPyTorch sets q from the prior in the first call
        model(F)
    start = torch.nn.utils.parameters_to_vector(parameters).detach().numpy().copy()
    note = "converged"
    try:
        minimize(negative, start, jac=True, method="L-BFGS-B", options={"maxiter": 100_000, "maxfun": 100_000})
    except DoneError:
        note = "there" if best > target else "limit"
    line(problem.n, "lbfgs", best, clock.seconds, model.judged(problem), note)


def svgp(problem, target, limit):
    n, F, y = problem.n, problem.F[: problem.n], problem.y[: problem.n]
    torch.manual_seed(0)
    model = Variational(F[torch.randperm(n)[: min(INDUCING, n)]].clone(), True).train()
    optimizer = torch.optim.Adam(model.parameters(), lr=0.05)
    clock, step, best, note = Clock(), 0, -math.inf, "limit"
    while clock.seconds < limit:
        rows = torch.randperm(n)[:MINIBATCH]
        optimizer.param_groups[0]["lr"] = 0.05 if clock.seconds < 0.5 * limit else 0.01
        optimizer.zero_grad()
        (-model.objective(F[rows], y[rows], n)).backward()
        optimizer.step()
        step += 1
        if step % 50 == 0:
            best = clock.without(lambda: model.whole(F, y))
            if best > target:
                note = "there"
                break
    line(n, "svgp", model.whole(F, y), clock.seconds, model.judged(problem), f"{note}, {step} steps")


def aepsych(problem, target, limit):
    from peers import AEPsych

    n, F = problem.n, problem.F[: problem.n].numpy()
    torch.manual_seed(0)
    peer = AEPsych(True, limit)
    peer.bounds = F.min(axis=0), F.max(axis=0)
    y = torch.from_numpy((problem.y[:n].numpy() > 0.0).astype(float))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings of its optimiser; only the result counts
        peer.model = peer._fresh(F.shape[1])
        _, seconds = timed(lambda: peer.model.fit(peer._unit(F), y, max_fit_time=limit))
        with torch.no_grad():
            mean, variance = peer.model.predict(peer._unit(problem.F_fresh))
        _, choosing = timed(lambda: peer.choose(TABLE_1, problem.features, BATCH, np.random.default_rng(1)))
    judged = verdict((mean / (1.0 + variance).sqrt()).numpy(), problem.y_fresh)
    line(n, "aepsych", None, seconds, judged, f"{choosing:.2f} s per batch")


PEERS = {"lbfgs": lbfgs, "svgp": svgp, "aepsych": aepsych}


def main():
    options = asked(
        __doc__,
        n=[250, 1000, 4000, 16000],
        features="paper",
        peers=[str],
        limit=60.0,
        short=0.5,
        inducing=[int],
        seed=0,
    )
    features = feature_map(options.features, TABLE_1)
    with one_thread():
        problem = Problem(features, 32, options.seed)  # everything is loaded and compiled before the clock runs
        propose(Latent(problem.fit(32)), features, TABLE_1, criterion("entropy"), 1, np.random.default_rng(0))
        head("n", "", "seconds", "objective", "accuracy", "log score", "")
        for n in options.n:
            problem = Problem(features, n, options.seed)
            if options.inducing:
                inducing_points(problem, options.inducing)
                continue
            objective = ours(problem)
            for name in options.peers:
                try:
                    PEERS[name](problem, objective - options.short, options.limit)
                except ImportError as error:
                    print(f"{name} is left out: {error}")


if __name__ == "__main__":
    main()
