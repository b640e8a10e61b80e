"""A robot of one number, its speed theta, that can be solved by hand: F = theta^2. The tutorial uses it, too."""

import numpy as np

import eipo


def toy(J, climb, cfg, iterations):
    """Lines 5 to 14 on one number, with the shipped line 13. returns alphas and thetas, one per iteration.

    climb(theta, alpha, weight): a step up on alpha J - weight F; pi has weight 1, pi_prime climbs J alone
    """
    theta, theta_prime, dual, history = 0.0, 0.0, eipo.Dual(0.2, 0.0), []
    for _ in range(iterations):
        theta, theta_prime = climb(theta, dual.alpha, 1), climb(theta_prime, 1.0, 0)
        dual = eipo.step_alpha(dual, J(theta) - J(theta_prime), cfg)
        history.append((dual.alpha, theta))
    return np.transpose(history)


def capped(theta):
    """J: faster than the command of 1 earns no more, as in Eq. (5), which has no kink there, however."""
    return min(theta, 1.0)


def climb_capped(theta, alpha, weight, lr=0.05):
    """The step down on F, then the one up on alpha J, which ends at the kink (a proximal gradient step)."""
    theta -= lr * weight * 2 * theta
    return max(theta, min(theta + lr * alpha, 1.0))


def smooth(theta):
    """J without a kink."""
    return -((theta - 1) ** 2)


def climb_smooth(theta, alpha, weight, lr=0.02):
    """A gradient step."""
    return theta - lr * (2 * alpha * (theta - 1) + weight * 2 * theta)
