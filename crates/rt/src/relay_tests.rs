extern crate std;
use super::*;
use crate::test_random::Random;
use std::vec::Vec;

const SETTINGS: RelaySettings = RelaySettings {
    bias: 0.5,
    step_up: 0.2,
    step_down: 0.2,
    setpoint: 0.0,
    hysteresis: 0.0,
    action: RelayAction::Direct,
    command_min: 0.0,
    command_max: 1.0,
    measured_min: -1.0,
    measured_max: 1.0,
    n_cycles: 4,
    tolerance: 0.01,
    timeout_s: 400.0,
    sample_time_s: 2e-3,
};

/// `gain e^{-delay s}/(s + 1)^3` around the bias.
struct ThreeLags {
    gain: f64,
    states: [f64; 3],
    queue: Vec<f64>,
    at: usize,
}

impl ThreeLags {
    fn new(gain: f64, delay_s: f64) -> Self {
        let n = (delay_s / SETTINGS.sample_time_s).round() as usize;
        Self { gain, states: [0.0; 3], queue: std::vec![0.0; n], at: 0 }
    }

    fn output(&self) -> f64 {
        self.gain * self.states[2]
    }

    fn advance(&mut self, u: f64) {
        let delayed = if self.queue.is_empty() {
            u
        } else {
            let old = core::mem::replace(&mut self.queue[self.at], u);
            self.at = (self.at + 1) % self.queue.len();
            old
        };
        // Exact for a held command: e^{-h} times the deviation from it, with 1, h and h^2/2 along the chain.
        let (h, decay) = (SETTINGS.sample_time_s, (-SETTINGS.sample_time_s).exp());
        let [a, b, c] = self.states.map(|x| x - delayed);
        self.states = [a, b + h * a, c + h * b + 0.5 * h * h * a].map(|x| delayed + decay * x);
    }
}

fn run(settings: RelaySettings, gain: f64, delay_s: f64, noise: f64) -> Relay {
    let mut relay = Relay::new(settings).expect("valid");
    let mut plant = ThreeLags::new(gain, delay_s);
    let mut random = Random::new(7);
    for _ in 0..1_000_000 {
        let measured = plant.output() + noise * random.between(-1.0, 1.0);
        if relay.advance(measured) != RelayStatus::Running {
            break;
        }
        let command = relay.command();
        assert!((settings.command_min..=settings.command_max).contains(&command));
        plant.advance(command - settings.bias);
    }
    relay
}

fn estimate(relay: &Relay) -> RelayEstimate {
    assert_eq!((relay.status(), relay.command()), (RelayStatus::Done, SETTINGS.bias));
    relay.estimate().expect("done")
}

#[test]
fn paper_a_lag_with_delay_has_the_known_limit_cycle() {
    // Between switches the output is one exponential, so amplitude and period are known in closed form (Åström and Hägglund 1984):
    // a = K d - (K d - h) e^{-L}, half a period L + ln((K d + a)/(K d - h)), in time constants.
    let t_s = SETTINGS.sample_time_s;
    for (gain, delay_s, h) in [(1.0, 0.5, 0.0), (2.5, 1.0, 0.05), (0.7, 0.2, 0.03)] {
        let relay_settings =
            RelaySettings { hysteresis: h, measured_min: -5.0, measured_max: 5.0, ..SETTINGS };
        let mut relay = Relay::new(relay_settings).expect("valid");
        let (mut y, mut queue) = (0.0_f64, std::vec![0.0; (delay_s / t_s).round() as usize]);
        for k in 0..1_000_000 {
            if relay.advance(y) != RelayStatus::Running {
                break;
            }
            let at = k % queue.len();
            let u = core::mem::replace(&mut queue[at], relay.command() - SETTINGS.bias);
            y = gain * u + (y - gain * u) * (-t_s).exp();
        }
        let found = estimate(&relay);
        let (kd, delay) = (gain * 0.2, delay_s);
        let a = kd - (kd - h) * (-delay).exp();
        let period = 2.0 * (delay + ((kd + a) / (kd - h)).ln());
        // Switches are seen up to a sample late: 2 samples a period, and as much of the slope in the amplitude.
        assert!((found.period_s - period).abs() <= 3.0 * t_s, "{found:?} {period}");
        assert!((found.amplitude / a - 1.0).abs() < 0.02, "{found:?} {a}");
        // The response is that of the plant, although the wave is far from a sine.
        let omega = core::f64::consts::TAU / found.period_s;
        let (size, phase) = (gain / (1.0 + omega * omega).sqrt(), -omega.atan() - omega * delay);
        let [re, im] = found.response;
        let off = (re - size * phase.cos()).hypot(im - size * phase.sin());
        assert!(off < 0.01 * size, "{found:?}: {off} of {size}");
        assert_eq!(found.static_gain, None);
    }
}

#[test]
fn law_three_lags_oscillate_near_their_critical_point() {
    // 1/(s + 1)^3: critical gain 8 at sqrt(3) rad/s. The describing function leaves out the harmonics, which a third-order lag
    // damps to (1/3)(1/20) and less.
    for (gain, action) in [(1.0, RelayAction::Direct), (-1.0, RelayAction::Reverse)] {
        let found = estimate(&run(RelaySettings { action, ..SETTINGS }, gain, 0.0, 0.0));
        let expected = core::f64::consts::TAU / 3.0_f64.sqrt();
        assert!((found.period_s / expected - 1.0).abs() < 0.02, "{found:?}");
        assert!((found.critical_gain / 8.0 - 1.0).abs() < 0.03, "{found:?}");
        // The oscillation is 1.5 % slow; the response is that at its own frequency.
        let omega = core::f64::consts::TAU / found.period_s;
        let (size, phase) = (gain * (1.0 + omega * omega).powf(-1.5), -3.0 * omega.atan());
        let [re, im] = found.response;
        assert!((re - size * phase.cos()).hypot(im - size * phase.sin()) < 1e-3 * size.abs(), "{found:?}");
    }
}

#[test]
fn law_the_loop_is_stable_below_the_critical_gain_and_not_above() {
    // The judge is the loop itself, run with a proportional controller of 0.9 and 1.1 times the gain found.
    for delay_s in [0.0, 0.3, 1.0, 4.0] {
        let found = estimate(&run(SETTINGS, 1.0, delay_s, 0.0));
        let late_over_early = |share: f64| {
            let mut plant = ThreeLags::new(1.0, delay_s);
            plant.states = [1e-3, 0.0, 0.0];
            let (n, mut early, mut late) = (200_000, 0.0_f64, 0.0_f64);
            for k in 0..n {
                let y = plant.output();
                if (n / 10..n / 5).contains(&k) {
                    early = early.max(y.abs());
                } else if k > n - n / 10 {
                    late = late.max(y.abs());
                }
                plant.advance(-share * found.critical_gain * y);
            }
            late / early
        };
        assert!(late_over_early(0.9) < 0.9, "{delay_s}: {found:?}");
        assert!(late_over_early(1.1) > 1.1, "{delay_s}: {found:?}");
    }
}

#[test]
fn law_fourier_sums_give_the_plant_under_noise_and_hysteresis() {
    // An asymmetric relay with hysteresis on a plant with delay and noise: the point is off the real axis, and known all the same.
    let settings =
        RelaySettings { step_up: 0.3, step_down: 0.15, hysteresis: 0.01, tolerance: 0.05, ..SETTINGS };
    let found = estimate(&run(settings, 1.0, 0.5, 0.004));
    let omega = core::f64::consts::TAU / found.period_s;
    let (size, phase) = ((1.0 + omega * omega).powf(-1.5), -3.0 * omega.atan() - 0.5 * omega);
    let [re, im] = found.response;
    assert!((re - size * phase.cos()).hypot(im - size * phase.sin()) < 0.01 * size, "{found:?}");
    assert!((found.static_gain.expect("asymmetric") - 1.0).abs() < 0.03, "{found:?}");
    assert!(found.period_spread < 0.05 && found.amplitude_spread < 0.05, "{found:?}");
}

#[test]
fn edge_it_does_not_start_outside_of_the_drive() {
    for bad in [
        RelaySettings { step_up: 0.51, ..SETTINGS },
        RelaySettings { step_down: 0.51, ..SETTINGS },
        RelaySettings { bias: f64::NAN, ..SETTINGS },
        RelaySettings { step_up: 0.0, ..SETTINGS },
        RelaySettings { command_max: f64::NAN, ..SETTINGS },
        RelaySettings { measured_min: 0.0, ..SETTINGS },
        RelaySettings { hysteresis: -1.0, ..SETTINGS },
        RelaySettings { n_cycles: 1, ..SETTINGS },
        RelaySettings { n_cycles: 17, ..SETTINGS },
        RelaySettings { timeout_s: 0.0, ..SETTINGS },
        RelaySettings { sample_time_s: f64::INFINITY, ..SETTINGS },
    ] {
        assert!(Relay::new(bad).is_err(), "{bad:?}");
    }
}

#[test]
fn edge_every_way_to_stop_ends_at_the_bias() {
    let mut relay = Relay::new(SETTINGS).expect("valid");
    assert_eq!(relay.command(), SETTINGS.bias);
    assert_eq!(relay.advance(f64::NAN), RelayStatus::Stopped(RelayStop::NotFinite));
    assert_eq!(relay.command(), SETTINGS.bias);
    let mut relay = Relay::new(SETTINGS).expect("valid");
    assert_eq!(relay.advance(1.5), RelayStatus::Stopped(RelayStop::MeasuredRange { measured: 1.5 }));
    assert_eq!((relay.advance(0.0), relay.command()), (relay.status(), SETTINGS.bias));
    // A dead sensor: the relay stays up until the time is over.
    let mut relay = Relay::new(RelaySettings { timeout_s: 1.0, ..SETTINGS }).expect("valid");
    let n = (0..10_000).take_while(|_| relay.advance(-0.01) == RelayStatus::Running).count();
    assert_eq!((n, relay.status()), (500, RelayStatus::Stopped(RelayStop::Timeout)));
    assert_eq!(relay.command(), SETTINGS.bias);
    assert!(relay.cycles().is_empty() && relay.estimate().is_none());
}

#[test]
fn edge_a_plant_that_wanders_is_not_called_steady() {
    // The gain grows with time, so no two cycles agree within the tolerance; the time runs out, and the command is at the bias.
    let settings = RelaySettings { timeout_s: 60.0, ..SETTINGS };
    let mut relay = Relay::new(settings).expect("valid");
    let mut plant = ThreeLags::new(1.0, 0.0);
    while relay.advance(plant.output()) == RelayStatus::Running {
        plant.gain *= 1.000_02;
        plant.advance(relay.command() - settings.bias);
    }
    assert_eq!(relay.status(), RelayStatus::Stopped(RelayStop::Timeout));
    assert_eq!((relay.command(), relay.estimate()), (settings.bias, None));
    assert!(relay.cycles().len() > 8);
}

#[test]
fn edge_a_sensor_that_toggles_is_chatter_and_not_an_oscillation() {
    // Two readings in turn have one period and one amplitude, and say nothing of the plant.
    let mut relay = Relay::new(SETTINGS).expect("valid");
    let n = (0..10_000).take_while(|k| relay.advance([-1e-3, 1e-3][k % 2]) == RelayStatus::Running).count();
    assert_eq!((relay.status(), relay.command()), (RelayStatus::Stopped(RelayStop::Chatter), SETTINGS.bias));
    assert!(n < 3 * RELAY_CYCLES_MAX && relay.estimate().is_none());
    // Noise without hysteresis on a live plant: never steady within a percent by chance.
    let noisy = run(RelaySettings { timeout_s: 100.0, ..SETTINGS }, 1.0, 0.2, 0.02);
    assert!(noisy.estimate().is_none(), "{:?}", noisy.estimate());
}
