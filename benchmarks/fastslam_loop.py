"""FastSLAM 1.0 (Montemerlo et al. 2002) as a loop over particles, in the manner of PythonRobotics.

A particle is a sampled pose and one small extended Kalman filter per landmark; measurements are
range and bearing; the weight is the likelihood of the innovation; resampling is of low variance,
below two thirds of effective particles. Association is known. As there, weighing and updating a
landmark each linearise for themselves and the gain is solved by a Cholesky factor.
"""

import math

import numpy as np
from slam_scenario import LANDMARKS, ODOMETRY_NOISE, SENSOR_NOISE, STEP, Drive


class Particle:
    """A sampled pose with its landmarks."""

    def __init__(self, weight: float) -> None:
        """Start at the origin with nothing seen.

        Args:
            weight: of the particle.
        """
        self.weight = weight
        self.pose = np.zeros(3)
        self.mean = np.zeros((len(LANDMARKS), 2))
        self.covariance = np.zeros((len(LANDMARKS), 2, 2))
        self.is_seen = np.zeros(len(LANDMARKS), bool)


def run(drive: Drive, num_particles: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Run the filter over a drive.

    Args:
        drive: T steps.
        num_particles: P.
        seed: of its own draws.

    Returns:
        Mean position of the robot f64[2] and of the landmarks f64[L, 2], metres.
    """
    random = np.random.default_rng(seed)
    particles = [Particle(1.0 / num_particles) for _ in range(num_particles)]
    for odometry, offsets in zip(drive.odometry, drive.offsets, strict=True):
        predict(particles, odometry, random)
        update(particles, offsets)
        particles = resample(particles, random)
    weight = np.array([one.weight for one in particles])
    robot = sum(w * one.pose[:2] for w, one in zip(weight, particles, strict=True))
    landmarks = sum(w * one.mean for w, one in zip(weight, particles, strict=True))
    return np.asarray(robot), np.asarray(landmarks)


def predict(particles: list[Particle], odometry: np.ndarray, random: np.random.Generator) -> None:
    """Draw every particle's motion."""
    for one in particles:
        noise = random.normal(size=2) * ODOMETRY_NOISE * STEP
        one.pose[:2] += odometry + noise
        one.pose[2] = wrap(one.pose[2])


def wrap(angle: float) -> float:
    """Bring an angle into [−π, π)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def update(particles: list[Particle], offsets: np.ndarray) -> None:
    """Update every landmark of every particle, and the weights."""
    for index, (x, y) in enumerate(offsets):
        distance = math.hypot(x, y)
        measured = np.array([distance, math.atan2(y, x)])
        # The same noise in each axis of the plane, in range and bearing.
        noise = np.diag([SENSOR_NOISE**2, (SENSOR_NOISE / distance) ** 2])
        for one in particles:
            if one.is_seen[index]:
                one.weight *= weigh_landmark(one, index, measured, noise)
                update_landmark(one, index, measured, noise)
            else:
                add_landmark(one, index, measured, noise)
    total = sum(one.weight for one in particles)
    for one in particles:
        one.weight = one.weight / total if total > 0.0 else 1.0 / len(particles)


def add_landmark(one: Particle, index: int, measured: np.ndarray, noise: np.ndarray) -> None:
    """Place a landmark where it was first seen."""
    distance, bearing = measured[0], one.pose[2] + measured[1]
    cosine, sine = math.cos(bearing), math.sin(bearing)
    one.mean[index] = one.pose[:2] + distance * np.array([cosine, sine])
    jacobian = np.array([[cosine, -distance * sine], [sine, distance * cosine]])
    one.covariance[index] = jacobian @ noise @ jacobian.T
    one.is_seen[index] = True


def linearise(
    one: Particle, index: int, measured: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute innovation [2], measurement Jacobian [2, 2] and innovation covariance [2, 2]."""
    dx, dy = one.mean[index] - one.pose[:2]
    squared = dx * dx + dy * dy
    distance = math.sqrt(squared)
    jacobian = np.array([[dx / distance, dy / distance], [-dy / squared, dx / squared]])
    predicted = np.array([distance, wrap(math.atan2(dy, dx) - one.pose[2])])
    innovation = measured - predicted
    innovation[1] = wrap(innovation[1])
    return innovation, jacobian, jacobian @ one.covariance[index] @ jacobian.T + noise


def weigh_landmark(one: Particle, index: int, measured: np.ndarray, noise: np.ndarray) -> float:
    """Evaluate the likelihood of a measurement."""
    innovation, _, spread = linearise(one, index, measured, noise)
    squared = float(innovation @ np.linalg.inv(spread) @ innovation)
    return math.exp(-0.5 * squared) / (2.0 * math.pi * math.sqrt(np.linalg.det(spread)))


def update_landmark(one: Particle, index: int, measured: np.ndarray, noise: np.ndarray) -> None:
    """Condition one landmark on range and bearing."""
    innovation, jacobian, spread = linearise(one, index, measured, noise)
    shared = one.covariance[index] @ jacobian.T
    root = np.linalg.inv(np.linalg.cholesky(0.5 * (spread + spread.T)).T)
    half = shared @ root
    one.mean[index] += half @ root.T @ innovation
    one.covariance[index] -= half @ half.T


def resample(particles: list[Particle], random: np.random.Generator) -> list[Particle]:
    """Draw particles anew by weight where too few count."""
    number = len(particles)
    weight = np.array([one.weight for one in particles])
    if 1.0 / float(weight @ weight) >= number / 1.5:
        return particles
    cumulative = np.cumsum(weight)
    teeth = (np.arange(number) + random.random()) / number
    drawn, index = [], 0
    for tooth in teeth:
        while index < number - 1 and tooth > cumulative[index]:
            index += 1
        drawn.append(copy_of(particles[index], 1.0 / number))
    return drawn


def copy_of(one: Particle, weight: float) -> Particle:
    """Copy a particle."""
    other = Particle(weight)
    other.pose, other.mean = one.pose.copy(), one.mean.copy()
    other.covariance, other.is_seen = one.covariance.copy(), one.is_seen.copy()
    return other
