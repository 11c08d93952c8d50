"""Compares covariances and likelihoods: the failure boundary learned again from the same designs.

    python studies/kernels.py collision matern52 matern52+average rbf ordinal --static 500 --seeds 1000 1001

A variant is a covariance (rbf, matern32, matern52, rq), with optional parts: "+linear"; "+one", a covariance of the
last feature alone; "+lapseX", labels that are wrong with probability X whatever the latent; "+tight", a prior of the
logarithm of the length scales with deviation 1 instead of 1.7; "+narrow", a prior of the output scale with deviation 1
instead of 2, and N(0, 1) for the mean; "+initial", hyperparameters learned from the first 250 designs only; "+warped",
every feature transformed to a normal distribution over the design space; "+average", probabilities averaged over
hyperparameters drawn from a Laplace approximation; "+mixed", averaged over those learned from all designs and those
learned from the first 250. "ordinal" is one latent and two thresholds for the three outcomes.
Scores on fresh designs: right sides of the boundary [%], mean log probability of the side [nat, times 100]; for
"ordinal" also that of the outcome.
"""

import math

import numpy as np
import torch
from outcomes import FRESH, INITIAL, outcome_of, samples
from peers import failure_margin
from scipy.optimize import minimize
from scipy.special import ndtr, ndtri
from scipy.stats import norm
from study import asked, uniform

from activefail.learning.features import feature_map
from activefail.learning.model import likelihoods, sites
from activefail.learning.model.covariance import JITTER
from activefail.learning.model.sites import Sites, Whole, solve_sites
from activefail.seismic.bearing import TABLE_1, simulate

NODES, WEIGHTS = likelihoods._NODES, likelihoods._WEIGHTS


def PROBIT(labels, mean, variance):
    """Of labels -1 and 1."""
    return likelihoods._of_probit(0.5 * (labels + 1.0), mean, variance)


def density(z, log_scale):
    """φ(z)/exp(log_scale)."""
    return torch.exp(-0.5 * z * z - 0.5 * math.log(2.0 * math.pi) - log_scale)


def expectations(log_likelihood):
    """`probit_expectations` of another likelihood, (label, f) -> (log p, its slope in f)."""

    def expected(labels, mean, variance):
        sd = variance.sqrt()
        value, slope = log_likelihood(labels.unsqueeze(-1), mean.unsqueeze(-1) + sd.unsqueeze(-1) * NODES)
        return value @ WEIGHTS, slope @ WEIGHTS, (-(slope @ (WEIGHTS * NODES)) / sd).clamp_min(0.0)

    return expected


def lapse(rate):
    def log_likelihood(y, f):
        value = torch.log(rate + (1.0 - 2.0 * rate) * torch.special.ndtr(y * f))
        return value, y * (1.0 - 2.0 * rate) * density(f, value)

    return expectations(log_likelihood)


def ordinal(width):
    """Outcome 0 where f + noise < 0, 1 below `width`, 2 above."""

    def log_likelihood(outcome, f):
        g = f - width
        none, failure = torch.special.log_ndtr(-f), torch.special.log_ndtr(g)
        # Φ(f) − Φ(g) by the tails of the nearer side.
        side = torch.where(f + g > 0.0, -1.0, 1.0)
        below, above = torch.where(side > 0.0, g, -f), torch.where(side > 0.0, f, -g)
        log_above = torch.special.log_ndtr(above)
        impact = log_above + torch.log1p(-torch.exp((torch.special.log_ndtr(below) - log_above).clamp_max(-1e-12)))
        slopes = -density(f, none), side * (density(above, impact) - density(below, impact)), density(g, failure)
        pick = [outcome == 0, outcome == 1]
        value = torch.where(pick[0], none, torch.where(pick[1], impact, failure))
        return value, torch.where(pick[0], slopes[0], torch.where(pick[1], slopes[1], slopes[2]))

    return expectations(log_likelihood)


def correlation(kind, A, B):
    squared = ((A * A).sum(1).unsqueeze(1) + (B * B).sum(1) - 2.0 * A @ B.T).clamp_min(1e-12)
    match kind:
        case "rbf":
            return torch.exp(-0.5 * squared)
        case "rq":
            return 1.0 / (1.0 + 0.5 * squared)
        case "matern32":
            r = (3.0 * squared).sqrt()
            return (1.0 + r) * torch.exp(-r)
        case "matern52":
            r = (5.0 * squared).sqrt()
            return (1.0 + r + r * r / 3.0) * torch.exp(-r)


class Variant:
    """A latent with any covariance, differentiated automatically; theta: mean, log scales, log threshold."""

    def __init__(self, name, F, labels):
        self.kind, *self.parts = ("matern52" if name == "ordinal" else name).split("+")
        self.threshold = name == "ordinal"
        self.F, self.labels = torch.from_numpy(F), torch.from_numpy(labels.astype(float))
        self.rate = next((float(part[5:]) for part in self.parts if part.startswith("lapse")), 0.0)
        n, self.m = F.shape
        self.sites = Sites(0.1 * torch.sign(self.labels - 0.5), torch.full((n,), 0.1, dtype=torch.float64))
        share = np.clip(np.mean(labels > 0), 1.0 / (n + 1), n / (n + 1.0))
        start = [ndtri(share), math.log(10.0)] + [0.5 * math.log(self.m)] * self.m
        start += (
            [0.0] * ("linear" in self.parts) + [math.log(5.0), 0.0] * ("one" in self.parts) + [1.0] * self.threshold
        )
        self.theta = np.array(start)
        bounds = [(-50.0, 50.0), (-5.0, 12.0)] + [(-5.0, 8.0)] * (len(start) - 2)
        options = {"ftol": 1e-5, "gtol": 1e-2, "maxiter": 100}
        self.at(minimize(self.objective, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x)

    def covariance(self, theta, A, B):
        scale = torch.exp(theta[2 : 2 + self.m])
        K, extra = torch.exp(theta[1]) * correlation(self.kind, A / scale, B / scale), torch.exp(theta[2 + self.m :])
        if "linear" in self.parts:
            K, extra = K + extra[0] * (A @ B.T), extra[1:]
        if "one" in self.parts:
            K = K + extra[0] * correlation("matern52", A[:, -1:] / extra[1], B[:, -1:] / extra[1])
        return K

    def log_prior(self, theta):
        def normal(x, mean, sd):
            return -0.5 * (((x - mean) / sd) ** 2).sum()

        scale, extra = theta[2 : 2 + self.m], theta[2 + self.m :]
        width = 1.0 if "tight" in self.parts else math.sqrt(3.0)
        narrow = "narrow" in self.parts
        value = normal(scale, math.sqrt(2.0) + 0.5 * math.log(self.m), width)
        value = value + normal(theta[1], math.log(10.0), 1.0 if narrow else 2.0)
        if narrow:
            value = value + normal(theta[0], 0.0, 1.0)
        return value + normal(extra, 1.0 if self.threshold else 0.0, 2.0)

    def likelihood(self, theta):
        if self.threshold:
            return ordinal(math.exp(theta[-1]))
        return lapse(self.rate) if self.rate else PROBIT

    def solve(self, theta, K, tolerance):
        expected = self.likelihood(theta)
        sites.expectations = lambda _, *of: expected(*of)  # what solve_sites climbs
        K = K.detach().clone()
        K.diagonal().add_(JITTER)
        prior = Whole(torch.full((len(K),), float(theta[0]), dtype=K.dtype), K)
        self.sites, state = solve_sites(prior, None, self.labels, self.sites, tolerance)
        return state

    def objective(self, theta, tolerance=1e-4):
        at = torch.tensor(theta, requires_grad=True)
        K, prior = self.covariance(at, self.F, self.F), self.log_prior(at)
        state = self.solve(theta, K, tolerance)
        root = self.sites.precision.sqrt()
        by_K = torch.outer(state.alpha, state.alpha) - root.unsqueeze(1) * torch.cholesky_inverse(state.factor) * root
        torch.autograd.backward([K, prior], [0.5 * by_K, None])
        gradient = at.grad.numpy().copy()
        gradient[0] += float(state.alpha.sum())
        if self.threshold:
            values = [
                float(ordinal(math.exp(theta[-1] + step))(self.labels, state.mean, state.variance)[0].sum())
                for step in (1e-4, -1e-4)
            ]
            gradient[-1] += (values[0] - values[1]) / 2e-4
        return -(state.elbo + float(prior.detach())), -gradient

    def at(self, theta):
        self.theta = theta
        self.state = self.solve(theta, self.covariance(torch.tensor(theta), self.F, self.F), 1e-5)

    def probit(self, F, threshold=0.0):
        """(mean − threshold)/√(1 + sd²) at scaled features, (n,)."""
        theta, root, z = torch.tensor(self.theta), self.sites.precision.sqrt(), []
        for A in torch.from_numpy(F).split(2000):
            k = self.covariance(theta, self.F, A)
            V = torch.linalg.solve_triangular(self.state.factor, root.unsqueeze(1) * k, upper=False)
            prior = torch.cat([self.covariance(theta, rows, rows).diagonal() for rows in A.split(50)])
            variance = (prior - (V * V).sum(0)).clamp_min(0.0)
            z.append((theta[0] + k.T @ self.state.alpha - threshold) / (1.0 + variance).sqrt())
        return torch.cat(z).numpy()

    def averaged(self, F, draws=8):
        """Mean probability over the optimum and draws around it."""
        best, p, step = self.theta, [ndtr(self.probit(F))], 0.05
        moves = step * np.eye(len(best))
        slopes = [self.objective(best + d, 1e-5)[1] - self.objective(best - d, 1e-5)[1] for d in moves]
        curvature, axes = np.linalg.eigh(np.stack(slopes) / (4.0 * step) + np.stack(slopes).T / (4.0 * step))
        rng = np.random.default_rng(5)
        for _ in range(draws):
            self.at(best + axes @ (rng.standard_normal(len(best)) / np.sqrt(np.maximum(curvature, 0.25))))
            p.append(ndtr(self.probit(F)))
        return np.mean(p, axis=0)


class WithMargins(Variant):
    """theta: 0, log scale and log length scales, log scale of the margin, artanh of the correlation, log noise."""

    def __init__(self, F, labels, margin):
        self.parts, self.threshold = [], False
        self.n, self.m = F.shape
        # The last column says which output a row is of.
        of_output = [np.column_stack([F, np.full(self.n, output)]) for output in (0.0, 1.0)]
        self.F = torch.from_numpy(np.concatenate(of_output))
        self.labels = torch.from_numpy(np.concatenate([labels, margin]))
        precision = np.repeat([0.1, 10.0], self.n)
        self.sites = Sites(self.labels * torch.from_numpy(precision), torch.from_numpy(precision))
        start = [0.0, math.log(10.0)] + [0.5 * math.log(self.m)] * self.m + [0.0, 1.0, math.log(0.3)]
        bounds = [(0.0, 0.0), (-5.0, 12.0)] + [(-5.0, 8.0)] * self.m + [(-4.0, 4.0), (-3.0, 3.0), (-4.0, 1.0)]
        options = {"ftol": 1e-5, "gtol": 1e-2, "maxiter": 100}
        self.at(minimize(self.objective, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x)

    def covariance(self, theta, A, B):
        length = torch.exp(theta[2 : 2 + self.m])
        scale = torch.exp(0.5 * theta[[1, 2 + self.m]])
        a, b = A[:, -1].long(), B[:, -1].long()
        same = torch.where(a.unsqueeze(1) == b, torch.ones_like(scale[0]), torch.tanh(theta[3 + self.m]))
        return scale[a].unsqueeze(1) * scale[b] * same * correlation("matern52", A[:, :-1] / length, B[:, :-1] / length)

    def log_prior(self, theta):
        means = [math.log(10.0)] + [math.sqrt(2.0) + 0.5 * math.log(self.m)] * self.m + [0.0, 1.0, -1.0]
        deviations = [2.0] + [math.sqrt(3.0)] * self.m + [2.0, 1.0, 1.0]
        return -0.5 * (((theta[1:] - torch.tensor(means)) / torch.tensor(deviations)) ** 2).sum()

    def likelihood(self, theta):
        noise = math.exp(2.0 * theta[-1])

        def expected(labels, mean, variance):
            n = self.n
            of_labels = PROBIT(labels[:n], mean[:n], variance[:n])
            off = labels[n:] - mean[n:]
            value = -0.5 * math.log(2.0 * math.pi * noise) - 0.5 * (off * off + variance[n:]) / noise
            of_margins = value, off / noise, torch.full_like(off, 1.0 / noise)
            return tuple(torch.cat(pair) for pair in zip(of_labels, of_margins, strict=True))

        return expected

    def objective(self, theta, tolerance=1e-4):
        value, gradient = super().objective(theta, tolerance)
        by_noise = [
            float(self.likelihood(np.append(theta[:-1], theta[-1] + step))(self.labels, *self.moments())[0].sum())
            for step in (1e-4, -1e-4)
        ]
        gradient[-1] -= (by_noise[0] - by_noise[1]) / 2e-4
        gradient[0] = 0.0
        return value, gradient

    def solve(self, theta, K, tolerance):
        self.solved = super().solve(theta, K, tolerance)
        return self.solved

    def moments(self):
        return self.solved.mean, self.solved.variance


def warped(F, reference):
    """Features as normal scores of their ranks among the reference, (n, m)."""
    ranks = [np.searchsorted(np.sort(column), f) for f, column in zip(F.T, reference.T, strict=True)]
    return norm.ppf(np.clip((np.column_stack(ranks) + 0.5) / (len(reference) + 1), 1e-4, 1.0 - 1e-4))


def log_score(p):
    return 100.0 * np.log(np.clip(p, 1e-12, None)).mean()


def report(name, F, outcome, F_fresh, happened, severity):
    beyond, labels = happened >= severity, np.where(outcome >= severity, 1.0, -1.0)
    variant = Variant(name, F, outcome if name == "ordinal" else labels)
    if "initial" in variant.parts:
        variant = learned_on_first(name, F, labels)
    first = ndtr(variant.probit(F_fresh))
    p, extra = variant.rate + (1.0 - 2.0 * variant.rate) * first, ""
    if variant.threshold:
        p = ndtr(variant.probit(F_fresh, math.exp(variant.theta[-1])))
        extra = f"  {log_score(np.choose(happened, [1.0 - first, first - p, p])):8.3f}"
    if "average" in variant.parts:
        p = variant.averaged(F_fresh)
    if "mixed" in variant.parts:
        p = 0.5 * (p + ndtr(learned_on_first(name, F, labels).probit(F_fresh)))
    return f"{100.0 * np.mean((p > 0.5) == beyond):8.3f}  {log_score(np.where(beyond, p, 1.0 - p)):8.3f}{extra}"


def learned_on_first(name, F, labels):
    """The posterior of all designs under the hyperparameters of the first `INITIAL`."""
    variant, all_of = Variant(name, F[:INITIAL], labels[:INITIAL]), Variant.__new__(Variant)
    all_of.__dict__ |= variant.__dict__
    all_of.F, all_of.labels = torch.from_numpy(F), torch.from_numpy(labels)
    all_of.sites = Sites(0.1 * all_of.labels, torch.full_like(all_of.labels, 0.1))
    all_of.at(variant.theta)
    return all_of


def report_margins(X, F, outcome, F_fresh, happened):
    """The scores with margins, the correlation, and the noise of the margin."""
    margin = failure_margin(X, simulate(X, threads=1))
    margin = np.sign(margin) * np.sqrt(np.abs(margin))
    for side in (margin > 0.0, margin <= 0.0):
        margin[side] /= np.abs(margin[side]).mean()
    both, failed = WithMargins(F, np.where(outcome == 2, 1.0, -1.0), margin), happened == 2
    z = both.probit(np.column_stack([F_fresh, np.zeros(len(F_fresh))]))
    scores = f"{100.0 * np.mean((z > 0.0) == failed):8.3f}  {log_score(ndtr(np.where(failed, z, -z))):8.3f}"
    return f"{scores}  correlation {np.tanh(both.theta[-2]):.3f}, noise {math.exp(both.theta[-1]):.3f}"


def main():
    options = asked(
        __doc__,
        words="set_and_variants",
        static=[int],
        active=[int],
        seeds=[1000],
        fresh=[777, 8],
        boundary="failure",
        criterion="entropy",
        impact=0.0,
    )
    torch.set_num_threads(1)
    name, *variants = options.set_and_variants
    features, X_fresh = feature_map(name, TABLE_1), uniform(FRESH, options.fresh)
    happened, F_fresh = outcome_of(X_fresh), features(X_fresh)
    reference = features(TABLE_1.sobol(4096, np.random.default_rng(0)))
    severity = 2 if options.boundary == "failure" else 1
    for how, X, outcome in samples(features, options):
        F = features(X)
        for variant in variants:
            if variant == "margins":
                figures = report_margins(X, F, outcome, F_fresh, happened)
            else:
                seen = (warped(F, reference), warped(F_fresh, reference)) if "warped" in variant else (F, F_fresh)
                figures = report(variant, seen[0], outcome, seen[1], happened, severity)
            print(f"{how}  {variant:22}  {figures}", flush=True)
        sites.expectations = likelihoods.expectations


if __name__ == "__main__":
    main()
