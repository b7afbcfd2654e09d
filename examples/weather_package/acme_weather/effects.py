"""An effect of our own: the laser of a LiDAR grows weaker."""

from torchweather.stages import Effect, Parameter


class AcmeGainDrift(Effect):
    """The laser grows weaker by ``loss_db``. Identity: 0 dB."""

    id = "lidar.acme_gain_drift"
    title, term = "the laser grows weaker", "laser power drift"
    arguments = (Parameter("loss_db", "dB", 0.0, 10.0, scale=1.0, identity=0.0),)
    after, axes = "particle_returns", ("intensity",)
    reads = writes = ("returns.signal",)

    def changes(self, state, noise):
        signal = state.returns.signal
        return {"signal": signal * 10 ** (-0.1 * self.value("loss_db", signal))}
