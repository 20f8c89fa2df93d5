"""Dense Kalman filter over robot and objects in moment form (section 3.2, certain association).

State: one coordinate (x and y are independent and share the covariance) of each object and of the
robot, the robot last. Motion x_r' = x_r + u + N(0, q); detection z = x_o − x_r + N(0, R); an object
seen for the first time has a flat prior: x_o = x_r + z. NumPy, float64.
"""

import numpy as np


class Kalman:
    """Mean f64[n, 2] and covariance f64[n, n]; objects enter in the order they are seen."""

    def __init__(self, start: np.ndarray, variance: float) -> None:
        self.names: list[int] = []
        self.mean = np.array([start], float)
        self.covariance = np.array([[variance]], float)

    def move(self, step: np.ndarray, variance: float) -> None:
        self.mean[-1] += step
        self.covariance[-1, -1] += variance

    def enter(self, name: int, offset: np.ndarray, noise: float) -> None:
        """Augment the state by x_o = x_r + z."""
        number = len(self.names)
        rows = np.insert(np.eye(number + 1), number, np.eye(number + 1)[-1], axis=0)
        added = np.zeros((number + 2, number + 2))
        added[number, number] = noise**2
        self.mean = rows @ self.mean
        self.mean[number] += offset
        self.covariance = rows @ self.covariance @ rows.T + added
        self.names.append(name)

    def correct(self, name: int, offset: np.ndarray, noise: float) -> None:
        """Condition on z = x_o − x_r + N(0, R)."""
        row = np.zeros(len(self.names) + 1)
        row[self.names.index(name)], row[-1] = 1.0, -1.0
        spread = row @ self.covariance @ row + noise**2
        gain = self.covariance @ row / spread
        self.mean = self.mean + np.outer(gain, offset - row @ self.mean)
        self.covariance = self.covariance - np.outer(gain, row @ self.covariance)

    def detect(self, name: int, offset: np.ndarray, noise: float) -> None:
        if name in self.names:
            self.correct(name, offset, noise)
        else:
            self.enter(name, offset, noise)
