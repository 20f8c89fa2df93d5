"""FastSLAM 1.0 (Montemerlo et al. 2002) as a loop over particles, similar to PythonRobotics.

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
        """Initialise at the origin without landmarks.

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
    rng = np.random.default_rng(seed)
    particles = [Particle(1.0 / num_particles) for _ in range(num_particles)]
    for odometry, offsets in zip(drive.odometry, drive.offsets, strict=True):
        predict(particles, odometry, rng)
        update(particles, offsets)
        particles = resample(particles, rng)
    weight = np.array([p.weight for p in particles])
    robot = sum(w * p.pose[:2] for w, p in zip(weight, particles, strict=True))
    landmarks = sum(w * p.mean for w, p in zip(weight, particles, strict=True))
    return np.asarray(robot), np.asarray(landmarks)


def predict(particles: list[Particle], odometry: np.ndarray, rng: np.random.Generator) -> None:
    """Sample the motion of every particle."""
    for particle in particles:
        noise = rng.normal(size=2) * ODOMETRY_NOISE * STEP
        particle.pose[:2] += odometry + noise
        particle.pose[2] = wrap(particle.pose[2])


def wrap(angle: float) -> float:
    """Wrap an angle to [−π, π)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def update(particles: list[Particle], offsets: np.ndarray) -> None:
    """Update every landmark of every particle, and the weights."""
    for index, (x, y) in enumerate(offsets):
        distance = math.hypot(x, y)
        z = np.array([distance, math.atan2(y, x)])
        # The same noise in each axis of the plane, in range and bearing.
        noise = np.diag([SENSOR_NOISE**2, (SENSOR_NOISE / distance) ** 2])
        for particle in particles:
            if particle.is_seen[index]:
                particle.weight *= weigh_landmark(particle, index, z, noise)
                update_landmark(particle, index, z, noise)
            else:
                add_landmark(particle, index, z, noise)
    total = sum(particle.weight for particle in particles)
    for particle in particles:
        particle.weight = particle.weight / total if total > 0.0 else 1.0 / len(particles)


def add_landmark(particle: Particle, index: int, z: np.ndarray, noise: np.ndarray) -> None:
    """Initialise a landmark from its first measurement."""
    distance, bearing = z[0], particle.pose[2] + z[1]
    cosine, sine = math.cos(bearing), math.sin(bearing)
    particle.mean[index] = particle.pose[:2] + distance * np.array([cosine, sine])
    jacobian = np.array([[cosine, -distance * sine], [sine, distance * cosine]])
    particle.covariance[index] = jacobian @ noise @ jacobian.T
    particle.is_seen[index] = True


def linearise(
    particle: Particle, index: int, z: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute innovation [2], measurement Jacobian [2, 2] and innovation covariance [2, 2]."""
    dx, dy = particle.mean[index] - particle.pose[:2]
    squared = dx * dx + dy * dy
    distance = math.sqrt(squared)
    jacobian = np.array([[dx / distance, dy / distance], [-dy / squared, dx / squared]])
    predicted = np.array([distance, wrap(math.atan2(dy, dx) - particle.pose[2])])
    innovation = z - predicted
    innovation[1] = wrap(innovation[1])
    return innovation, jacobian, jacobian @ particle.covariance[index] @ jacobian.T + noise


def weigh_landmark(particle: Particle, index: int, z: np.ndarray, noise: np.ndarray) -> float:
    """Evaluate the likelihood of a measurement."""
    innovation, _, innovation_cov = linearise(particle, index, z, noise)
    squared = float(innovation @ np.linalg.inv(innovation_cov) @ innovation)
    return math.exp(-0.5 * squared) / (2.0 * math.pi * math.sqrt(np.linalg.det(innovation_cov)))


def update_landmark(particle: Particle, index: int, z: np.ndarray, noise: np.ndarray) -> None:
    """Update one landmark by the EKF with range and bearing."""
    innovation, jacobian, innovation_cov = linearise(particle, index, z, noise)
    cross_cov = particle.covariance[index] @ jacobian.T
    root = np.linalg.inv(np.linalg.cholesky(0.5 * (innovation_cov + innovation_cov.T)).T)
    gain_root = cross_cov @ root
    particle.mean[index] += gain_root @ root.T @ innovation
    particle.covariance[index] -= gain_root @ gain_root.T


def resample(particles: list[Particle], rng: np.random.Generator) -> list[Particle]:
    """Resample systematically if the effective sample size is below two thirds."""
    count = len(particles)
    weight = np.array([particle.weight for particle in particles])
    if 1.0 / float(weight @ weight) >= count / 1.5:
        return particles
    cumulative = np.cumsum(weight)
    positions = (np.arange(count) + rng.random()) / count
    resampled, index = [], 0
    for position in positions:
        while index < count - 1 and position > cumulative[index]:
            index += 1
        resampled.append(copy_of(particles[index], 1.0 / count))
    return resampled


def copy_of(particle: Particle, weight: float) -> Particle:
    """Copy a particle."""
    copy = Particle(weight)
    copy.pose, copy.mean = particle.pose.copy(), particle.mean.copy()
    copy.covariance, copy.is_seen = particle.covariance.copy(), particle.is_seen.copy()
    return copy
