//! From a unit command to volts: the place where the square law of the actuator is undone.

/// How a unit command `q` (0..1, 1 = full scale) becomes a voltage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum InputLinearisation {
    /// Volts proportional to the command, as in the paper: the plant's gain then grows with the bias.
    #[default]
    Identity,
    /// Volts as the root of the command: electrostatic force goes with the square of the voltage, so force is proportional to the command.
    SquareRoot,
}

impl InputLinearisation {
    /// The voltage in volts for command `q`: `full_scale_v * q` or `full_scale_v * sqrt(max(q, 0))`. NaN stays NaN.
    #[must_use]
    pub fn volts(self, q: f64, full_scale_v: f64) -> f64 {
        match self {
            Self::Identity => full_scale_v * q,
            // `max` would turn NaN into zero; a comparison keeps it, and the limits see it.
            Self::SquareRoot => full_scale_v * libm::sqrt(if q < 0.0 { 0.0 } else { q }),
        }
    }

    /// The unit command that yields `voltage_v`: the inverse of [`volts`](Self::volts) for commands of at least zero.
    #[must_use]
    pub fn command(self, voltage_v: f64, full_scale_v: f64) -> f64 {
        let ratio = voltage_v / full_scale_v;
        match self {
            Self::Identity => ratio,
            Self::SquareRoot => ratio * ratio,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_command_inverts_volts() {
        for linearisation in [InputLinearisation::Identity, InputLinearisation::SquareRoot] {
            for step in 0..=100_u8 {
                let q = f64::from(step) / 100.0;
                let back = linearisation.command(linearisation.volts(q, 5000.0), 5000.0);
                assert!((back - q).abs() < 1e-15, "{linearisation:?} {q} {back}");
            }
        }
    }

    #[test]
    fn edge_negative_and_nan_commands() {
        assert_eq!(InputLinearisation::SquareRoot.volts(-0.3, 5000.0), 0.0);
        assert_eq!(InputLinearisation::Identity.volts(-0.3, 5000.0), -1500.0);
        assert!(InputLinearisation::SquareRoot.volts(f64::NAN, 5000.0).is_nan());
        assert_eq!(InputLinearisation::SquareRoot.volts(0.25, 5000.0), 2500.0);
    }
}
