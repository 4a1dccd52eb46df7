//! The one cycle that every rig runs, simulated or real.

use crate::error::{Error, finite, positive};
use crate::{
    Drive, DriveVoltage, InputLinearisation, Limits, LowPass, ModalDeltaController, MonotonicNs, Pid,
    PidInput, Sensor, SensorFault, Signal, TripReason,
};

/// From a sensor's reading to the controlled variable: `gain * reading + offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorScale {
    /// Controlled variable per unit of reading; negative for a distance that shrinks as the plate comes closer.
    pub gain: f64,
    /// Controlled variable at a reading of zero.
    pub offset: f64,
}

impl Default for SensorScale {
    /// The reading is the controlled variable.
    fn default() -> Self {
        Self { gain: 1.0, offset: 0.0 }
    }
}

/// What turns an error into a unit command.
#[derive(Debug, Clone, PartialEq)]
// Without an allocator the modes live in the enum; one loop holds exactly one law, so nothing is wasted by the small variants.
#[allow(clippy::large_enum_variant)]
pub enum ControlLaw {
    /// A linear controller in modal delta form.
    ModalDelta(ModalDeltaController),
    /// A PID controller, with its own anti-windup.
    Pid(Pid),
    /// No feedback: the command is feedforward plus trim.
    OpenLoop,
}

/// The sign that the error gets before it enters the law.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ErrorSign {
    /// `r - y`: more voltage raises the controlled variable.
    #[default]
    Positive,
    /// `y - r`: more voltage lowers the controlled variable, as with a load cell above the plate.
    Negative,
}

/// What a [`ControlLaw::ModalDelta`] does while the command is saturated. A [`Pid`] has its own setting and ignores this one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AntiWindup {
    /// Its states advance with the true error.
    #[default]
    None,
    /// Its states advance with zero error while the error pushes the command further out.
    ///
    /// It assumes a law of positive gain: a positive error raises the command.
    HoldOutward,
}

/// Where the filters stand before their first sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FilterStart {
    /// Settled at their first input: no start transient.
    #[default]
    AtFirstSample,
    /// Settled at zero, as a block diagram does.
    AtZero,
}

/// All settings of a [`ControlLoop`].
#[derive(Debug, Clone, PartialEq)]
pub struct ControlSettings {
    /// Time between cycles, in seconds; filters and law must have been sampled with the same.
    pub sample_time_s: f64,
    /// From reading to controlled variable.
    pub sensor_scale: SensorScale,
    /// Filter of the measurement, usually Eq. (26).
    pub measurement_filter: Option<LowPass>,
    /// Filter of the reference; the same as the measurement's makes the filter's lag cancel in the error.
    pub reference_filter: Option<LowPass>,
    /// Where both filters start.
    pub filter_start: FilterStart,
    /// From error to unit command.
    pub law: ControlLaw,
    /// Sign of the error as the law sees it.
    pub error_sign: ErrorSign,
    /// Unit command that is always added: the bias of the operating point.
    pub trim: f64,
    /// From unit command to volts.
    pub linearisation: InputLinearisation,
    /// Volts at a unit command of 1.
    pub full_scale_v: f64,
    /// Range and slew that no voltage leaves.
    pub limits: Limits,
    /// What a modal law does while saturated.
    pub anti_windup: AntiWindup,
}

/// The settings of a loop and everything it remembers from one cycle to the next.
///
/// It latches: after a trip each further [`cycle`] commands zero volts and returns the same reason, until
/// [`reset`](Self::reset).
#[derive(Debug, Clone, PartialEq)]
pub struct ControlLoop {
    settings: ControlSettings,
    previous: DriveVoltage,
    started: bool,
    tripped: Option<TripReason>,
    law_gain: f64,
}

/// What a cycle is asked to follow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CycleInputs {
    /// Reference `r` in the controlled variable's unit.
    pub reference: f64,
    /// Unit command added to the law's; the output of a preview filter, or zero.
    pub feedforward: f64,
}

/// What a cycle did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CycleOutput {
    /// The scaled measurement before its filter, in the controlled variable's unit.
    pub measured: f64,
    /// The measurement after its filter; the same as `measured` without one.
    pub filtered: f64,
    /// Filtered reference minus filtered measurement, before [`ErrorSign`].
    pub error: f64,
    /// The unit command that was asked for: law + feedforward + trim.
    pub command: f64,
    /// The voltage that was applied, in volts.
    pub voltage_v: f64,
    /// True where the applied voltage is not the one that was asked for.
    pub saturated: bool,
}

impl ControlLoop {
    /// A loop at rest: the law's states as given, the previous voltage at zero.
    ///
    /// # Errors
    /// [`Error::NotPositive`] or [`Error::NotFinite`] for sample time, scale, trim or full scale.
    pub fn new(settings: ControlSettings) -> Result<Self, Error> {
        positive("sample time in seconds", settings.sample_time_s)?;
        positive("magnitude of the sensor gain", settings.sensor_scale.gain.abs())?;
        finite("sensor offset", settings.sensor_scale.offset)?;
        finite("trim in unit command", settings.trim)?;
        positive("full scale in volts", settings.full_scale_v)?;
        let previous = settings.limits.off();
        Ok(Self { settings, previous, started: false, tripped: None, law_gain: 1.0 })
    }

    /// The settings, with the present states of law and filters.
    #[must_use]
    pub fn settings(&self) -> &ControlSettings {
        &self.settings
    }

    /// Multiplies the error that the law sees from the next cycle on; 1 at first. States stay, so that the command does not jump.
    ///
    /// # Errors
    /// [`Error::NotPositive`] or [`Error::NotFinite`]; then the gain is as it was.
    pub fn set_law_gain(&mut self, gain: f64) -> Result<(), Error> {
        positive("gain of the law", gain)?;
        self.law_gain = gain;
        Ok(())
    }

    /// The voltage commanded last.
    #[must_use]
    pub fn previous_voltage(&self) -> DriveVoltage {
        self.previous
    }

    /// Why the loop is latched at zero volts, if it is.
    #[must_use]
    pub fn tripped(&self) -> Option<TripReason> {
        self.tripped
    }

    /// Clears a trip and puts law, filters and previous voltage back to rest.
    pub fn reset(&mut self) {
        match &mut self.settings.law {
            ControlLaw::ModalDelta(controller) => controller.reset(),
            ControlLaw::Pid(pid) => pid.reset(),
            ControlLaw::OpenLoop => {}
        }
        self.previous = self.settings.limits.off();
        self.started = false;
        self.tripped = None;
    }

    /// Commands zero volts at once, without a slew limit, and latches `reason` unless an earlier one is latched.
    pub fn trip<R: Drive>(&mut self, rig: &mut R, now: MonotonicNs, reason: TripReason) -> TripReason {
        let lowest = self.settings.limits.off();
        // A drive that refuses this one as well leaves nothing that software can do; the first reason is the one to report.
        let _ = rig.apply(now, lowest);
        self.previous = lowest;
        *self.tripped.get_or_insert(reason)
    }

    fn start_filters(&mut self, measured: f64, reference: f64) {
        let at = |value| match self.settings.filter_start {
            FilterStart::AtFirstSample => value,
            FilterStart::AtZero => 0.0,
        };
        let (measured, reference) = (at(measured), at(reference));
        if let Some(filter) = &mut self.settings.measurement_filter {
            filter.reset(measured);
        }
        if let Some(filter) = &mut self.settings.reference_filter {
            filter.reset(reference);
        }
        self.started = true;
    }

    /// Everything before the drive: filter, error, law, feedforward, trim, linearisation, limits.
    fn decide(&self, measured: f64, inputs: CycleInputs) -> Decision {
        let settings = &self.settings;
        let filtered = settings.measurement_filter.map_or(measured, |f| f.output(measured));
        let reference = settings.reference_filter.map_or(inputs.reference, |f| f.output(inputs.reference));
        let error = reference - filtered;
        let (law_error, law_reference) = match settings.error_sign {
            ErrorSign::Positive => (self.law_gain * error, self.law_gain * reference),
            ErrorSign::Negative => (-self.law_gain * error, -self.law_gain * reference),
        };
        let pid_input = PidInput { error: law_error, reference: law_reference };
        let feedback = match &settings.law {
            ControlLaw::ModalDelta(controller) => controller.output(law_error),
            ControlLaw::Pid(pid) => pid.output(pid_input),
            ControlLaw::OpenLoop => 0.0,
        };
        let command = feedback + inputs.feedforward + settings.trim;
        let request_v = settings.linearisation.volts(command, settings.full_scale_v);
        let limited = settings.limits.clamp(request_v, self.previous, settings.sample_time_s);
        // The square root hides a negative command from the limits.
        let below_root = settings.linearisation == InputLinearisation::SquareRoot && command < 0.0;
        let saturated = limited.saturated || below_root;
        let excess = if saturated {
            settings.linearisation.command(limited.voltage.volts(), settings.full_scale_v) - command
        } else {
            0.0
        };
        Decision { filtered, error, pid_input, command, voltage: limited.voltage, saturated, excess }
    }

    fn advance(&mut self, measured: f64, inputs: CycleInputs, decision: &Decision) {
        if let Some(filter) = &mut self.settings.measurement_filter {
            filter.advance(measured);
        }
        if let Some(filter) = &mut self.settings.reference_filter {
            filter.advance(inputs.reference);
        }
        match &mut self.settings.law {
            ControlLaw::ModalDelta(controller) => {
                let outward = decision.excess * decision.pid_input.error < 0.0;
                let hold = self.settings.anti_windup == AntiWindup::HoldOutward && outward;
                controller.advance(if hold { 0.0 } else { decision.pid_input.error });
            }
            ControlLaw::Pid(pid) => pid.advance(decision.pid_input, decision.excess),
            ControlLaw::OpenLoop => {}
        }
        self.previous = decision.voltage;
    }
}

/// Runs one cycle: read, scale, filter, error, law + feedforward + trim, linearise, limit, drive, advance the states.
///
/// It does not allocate, has no loop but the one over the law's modes, and never lets a value that is not finite reach the drive.
///
/// # Errors
/// A [`TripReason`] for a sensor or drive fault or a signal that is not finite. The lowest voltage has been commanded by then, and the
/// loop is latched.
pub fn cycle<R: Sensor + Drive>(
    rig: &mut R,
    control: &mut ControlLoop,
    now: MonotonicNs,
    inputs: CycleInputs,
) -> Result<CycleOutput, TripReason> {
    if let Some(reason) = control.tripped {
        return Err(control.trip(rig, now, reason));
    }
    match run(rig, control, now, inputs) {
        Ok(output) => Ok(output),
        Err(reason) => Err(control.trip(rig, now, reason)),
    }
}

fn run<R: Sensor + Drive>(
    rig: &mut R,
    control: &mut ControlLoop,
    now: MonotonicNs,
    inputs: CycleInputs,
) -> Result<CycleOutput, TripReason> {
    let reading = rig.read(now).map_err(TripReason::Sensor)?;
    if !reading.value.is_finite() {
        return Err(TripReason::Sensor(SensorFault::NotFinite));
    }
    let scale = control.settings.sensor_scale;
    let measured = check(Signal::Measurement, scale.gain * reading.value + scale.offset)?;
    check(Signal::Reference, inputs.reference)?;
    check(Signal::Feedforward, inputs.feedforward)?;
    if !control.started {
        control.start_filters(measured, inputs.reference);
    }
    let decision = control.decide(measured, inputs);
    check(Signal::Command, decision.command)?;
    rig.apply(now, decision.voltage).map_err(TripReason::Drive)?;
    control.advance(measured, inputs, &decision);
    Ok(CycleOutput {
        measured,
        filtered: decision.filtered,
        error: decision.error,
        command: decision.command,
        voltage_v: decision.voltage.volts(),
        saturated: decision.saturated,
    })
}

struct Decision {
    filtered: f64,
    error: f64,
    /// Error and reference as the law sees them.
    pid_input: PidInput,
    command: f64,
    voltage: DriveVoltage,
    saturated: bool,
    /// Unit command applied minus unit command asked for; zero when not saturated.
    excess: f64,
}

fn check(signal: Signal, value: f64) -> Result<f64, TripReason> {
    if value.is_finite() { Ok(value) } else { Err(TripReason::NotFinite(signal)) }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::test_random::Random;
    use crate::{DriveFault, EQ26_CUTOFF_RAD_S, PidAntiWindup, PidGains, Reading, RealMode};
    use std::vec::Vec;

    const SAMPLE_TIME_S: f64 = 1e-3;

    /// First-order plant `y = gain * (V/5000)`, 50 ms, that records each voltage and can be told to fail.
    struct TestRig {
        y: f64,
        gain: f64,
        voltage_v: f64,
        applied_v: Vec<f64>,
        sensor: Option<Result<Reading, SensorFault>>,
        refuse: bool,
    }

    impl TestRig {
        fn new(gain: f64) -> Self {
            Self { y: 0.0, gain, voltage_v: 0.0, applied_v: Vec::new(), sensor: None, refuse: false }
        }

        fn step(&mut self) {
            self.y += (SAMPLE_TIME_S / 0.05) * (self.gain * self.voltage_v / 5000.0 - self.y);
        }
    }

    impl Sensor for TestRig {
        fn read(&mut self, _now: MonotonicNs) -> Result<Reading, SensorFault> {
            // A laser 50 mm above the rest position: distance falls as y grows.
            self.sensor.unwrap_or(Ok(Reading { value: 50.0 - self.y }))
        }
    }

    impl Drive for TestRig {
        fn apply(&mut self, _now: MonotonicNs, voltage: DriveVoltage) -> Result<(), DriveFault> {
            if self.refuse {
                return Err(DriveFault::Refused);
            }
            self.voltage_v = voltage.volts();
            self.applied_v.push(self.voltage_v);
            Ok(())
        }
    }

    fn integrator() -> ControlLaw {
        // Gain 10 per second.
        let mode = RealMode { lambda: 0.0, b: SAMPLE_TIME_S, c: 10.0 };
        ControlLaw::ModalDelta(ModalDeltaController::new(&[mode], &[], 0.0).expect("valid mode"))
    }

    fn settings(law: ControlLaw) -> ControlSettings {
        ControlSettings {
            sample_time_s: SAMPLE_TIME_S,
            sensor_scale: SensorScale { gain: -1.0, offset: 50.0 },
            measurement_filter: None,
            reference_filter: None,
            filter_start: FilterStart::AtFirstSample,
            law,
            error_sign: ErrorSign::Positive,
            trim: 0.0,
            linearisation: InputLinearisation::Identity,
            full_scale_v: 5000.0,
            limits: Limits::new(0.0, 5000.0, f64::INFINITY).expect("valid limits"),
            anti_windup: AntiWindup::None,
        }
    }

    fn follow(rig: &mut TestRig, control: &mut ControlLoop, reference: f64, n_cycles: u64) -> CycleOutput {
        let mut last = None;
        for k in 0..n_cycles {
            let inputs = CycleInputs { reference, feedforward: 0.0 };
            last = Some(cycle(rig, control, MonotonicNs(k * 1_000_000), inputs).expect("no fault"));
            rig.step();
        }
        last.expect("at least one cycle")
    }

    #[test]
    fn law_integral_loop_settles_on_the_reference() {
        for linearisation in [InputLinearisation::Identity, InputLinearisation::SquareRoot] {
            let mut control =
                ControlLoop::new(ControlSettings { linearisation, ..settings(integrator()) }).expect("valid");
            let mut rig = TestRig::new(1.0);
            let last = follow(&mut rig, &mut control, 0.4, 5000);
            assert!((rig.y - 0.4).abs() < 1e-9, "{linearisation:?}: {}", rig.y);
            let expected = if linearisation == InputLinearisation::Identity { 0.4 } else { 0.16 };
            assert!((last.command - expected).abs() < 1e-9 && !last.saturated);
        }
    }

    #[test]
    fn law_negative_plant_needs_the_negative_error_sign() {
        let negative =
            ControlSettings { error_sign: ErrorSign::Negative, trim: 0.8, ..settings(integrator()) };
        let mut control = ControlLoop::new(negative).expect("valid");
        let mut rig = TestRig::new(-1.0);
        let last = follow(&mut rig, &mut control, -0.3, 5000);
        assert!((rig.y + 0.3).abs() < 1e-9, "{}", rig.y);
        assert!((last.command - 0.3).abs() < 1e-9);
    }

    #[test]
    fn law_open_loop_command_is_feedforward_plus_trim() {
        let mut control = ControlLoop::new(ControlSettings { trim: 0.25, ..settings(ControlLaw::OpenLoop) })
            .expect("valid");
        let mut rig = TestRig::new(1.0);
        let inputs = CycleInputs { reference: 9.0, feedforward: 0.125 };
        let output = cycle(&mut rig, &mut control, MonotonicNs(0), inputs).expect("no fault");
        assert_eq!((output.command, output.voltage_v), (0.375, 1875.0));
    }

    #[test]
    fn law_equal_filters_cancel_on_a_perfectly_tracked_ramp() {
        let filter = Some(LowPass::new(EQ26_CUTOFF_RAD_S, SAMPLE_TIME_S).expect("valid filter"));
        let both = ControlSettings {
            measurement_filter: filter,
            reference_filter: filter,
            ..settings(ControlLaw::OpenLoop)
        };
        let mut control = ControlLoop::new(both).expect("valid");
        let mut rig = TestRig::new(0.0);
        for k in 0..500_u32 {
            rig.y = 0.7 + 1e-3 * f64::from(k);
            let inputs = CycleInputs { reference: rig.y, feedforward: 0.0 };
            let output = cycle(&mut rig, &mut control, MonotonicNs(0), inputs).expect("no fault");
            // 50 - (50 - y) costs a few ulps of 50.
            assert!(output.error.abs() < 1e-13, "cycle {k}: {}", output.error);
            assert!(k > 0 || (output.filtered - 0.7).abs() < 1e-13, "no start transient");
        }
    }

    #[test]
    fn edge_hold_outward_recovers_sooner_than_no_anti_windup() {
        let cycles_to_recover = |anti_windup| {
            let wound = ControlSettings { anti_windup, ..settings(integrator()) };
            let mut control = ControlLoop::new(wound).expect("valid");
            let mut rig = TestRig::new(1.0);
            let last = follow(&mut rig, &mut control, 2.0, 2000);
            assert!(last.saturated && last.voltage_v == 5000.0);
            for k in 0..5000_u64 {
                let inputs = CycleInputs { reference: 0.2, feedforward: 0.0 };
                let output = cycle(&mut rig, &mut control, MonotonicNs(k), inputs).expect("no fault");
                rig.step();
                if !output.saturated {
                    return k;
                }
            }
            5000
        };
        assert!(cycles_to_recover(AntiWindup::HoldOutward) <= 1);
        assert!(cycles_to_recover(AntiWindup::None) > 1000);
    }

    #[test]
    fn edge_pid_clamps_below_the_root() {
        let gains = PidGains { p: 0.0, i_per_s: 10.0, d_s: 0.0, n_rad_s: 0.0 };
        let pid = Pid::new(gains, SAMPLE_TIME_S, PidAntiWindup::Clamping).expect("valid gains");
        let rooted = ControlSettings {
            linearisation: InputLinearisation::SquareRoot,
            ..settings(ControlLaw::Pid(pid))
        };
        let mut control = ControlLoop::new(rooted).expect("valid");
        let mut rig = TestRig::new(1.0);
        let last = follow(&mut rig, &mut control, -1.0, 3000);
        assert!(last.saturated && last.voltage_v == 0.0);
        // Without clamping it would have wound to -30.
        assert!(last.command > -0.03, "{}", last.command);
    }

    #[test]
    fn edge_slew_limit_ramps_the_voltage() {
        let slow = ControlSettings {
            trim: 1.0,
            limits: Limits::new(0.0, 5000.0, 1e5).expect("valid limits"),
            ..settings(ControlLaw::OpenLoop)
        };
        let mut control = ControlLoop::new(slow).expect("valid");
        let mut rig = TestRig::new(1.0);
        follow(&mut rig, &mut control, 0.0, 60);
        assert!((rig.applied_v[9] - 1000.0).abs() < 1e-9);
        assert_eq!(rig.applied_v[59], 5000.0);
    }

    #[test]
    fn edge_every_fault_ends_at_the_lowest_voltage_and_latches() {
        let bad_inputs = [
            (CycleInputs { reference: f64::NAN, feedforward: 0.0 }, TripReason::NotFinite(Signal::Reference)),
            (
                CycleInputs { reference: 0.0, feedforward: f64::INFINITY },
                TripReason::NotFinite(Signal::Feedforward),
            ),
        ];
        for (inputs, expected) in bad_inputs {
            let mut control = ControlLoop::new(settings(integrator())).expect("valid");
            let mut rig = TestRig::new(1.0);
            follow(&mut rig, &mut control, 0.5, 100);
            assert!(rig.voltage_v > 0.0);
            assert_eq!(cycle(&mut rig, &mut control, MonotonicNs(0), inputs), Err(expected));
            assert_eq!(rig.voltage_v, 0.0);
            let good = CycleInputs { reference: 0.5, feedforward: 0.5 };
            assert_eq!(cycle(&mut rig, &mut control, MonotonicNs(0), good), Err(expected), "it must latch");
            assert_eq!(rig.voltage_v, 0.0);
            control.reset();
            assert!(cycle(&mut rig, &mut control, MonotonicNs(0), good).is_ok());
        }
        for (sensor, expected) in [
            (Err(SensorFault::Stale), TripReason::Sensor(SensorFault::Stale)),
            (Ok(Reading { value: f64::NAN }), TripReason::Sensor(SensorFault::NotFinite)),
        ] {
            let mut control = ControlLoop::new(settings(integrator())).expect("valid");
            let mut rig = TestRig::new(1.0);
            follow(&mut rig, &mut control, 0.5, 100);
            rig.sensor = Some(sensor);
            let inputs = CycleInputs { reference: 0.5, feedforward: 0.0 };
            assert_eq!(cycle(&mut rig, &mut control, MonotonicNs(0), inputs), Err(expected));
            assert_eq!(rig.voltage_v, 0.0);
        }
    }

    #[test]
    fn edge_a_refusing_drive_trips() {
        let mut control = ControlLoop::new(settings(integrator())).expect("valid");
        let mut rig = TestRig::new(1.0);
        rig.refuse = true;
        let inputs = CycleInputs { reference: 0.5, feedforward: 0.0 };
        let expected = TripReason::Drive(DriveFault::Refused);
        assert_eq!(cycle(&mut rig, &mut control, MonotonicNs(0), inputs), Err(expected));
        assert_eq!(control.previous_voltage().volts(), 0.0);
    }

    #[test]
    fn law_no_voltage_ever_leaves_the_limits() {
        for seed in 0..200 {
            let mut random = Random::new(seed);
            let min_v = random.between(0.0, 1000.0);
            let max_v = min_v + random.between(1.0, 4000.0);
            let mode = RealMode {
                lambda: random.between(-0.5, 0.5),
                b: random.between(-5.0, 5.0),
                c: random.between(-5.0, 5.0),
            };
            let law = ControlLaw::ModalDelta(
                ModalDeltaController::new(&[mode], &[], random.between(-9.0, 9.0)).expect("valid mode"),
            );
            let slew_v_per_s = if seed % 2 == 0 { f64::INFINITY } else { random.between(1.0, 1e7) };
            let wild = ControlSettings {
                linearisation: if seed % 3 == 0 {
                    InputLinearisation::SquareRoot
                } else {
                    InputLinearisation::Identity
                },
                limits: Limits::new(min_v, max_v, slew_v_per_s).expect("valid limits"),
                ..settings(law)
            };
            let mut control = ControlLoop::new(wild).expect("valid");
            let mut rig = TestRig::new(1.0);
            for _ in 0..300 {
                let exotic = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300];
                let reference =
                    if random.below(50) == 0 { exotic[random.below(5)] } else { random.between(-3.0, 3.0) };
                let inputs = CycleInputs { reference, feedforward: random.between(-2.0, 2.0) };
                if cycle(&mut rig, &mut control, MonotonicNs(0), inputs).is_err() {
                    assert_eq!(rig.voltage_v, 0.0, "seed {seed}: a trip ends at zero volts");
                    control.reset();
                }
                rig.step();
            }
            let outside = rig.applied_v.iter().find(|v| !(**v >= min_v && **v <= max_v) && **v != 0.0);
            assert_eq!(outside, None, "seed {seed}");
        }
    }

    #[test]
    fn edge_bad_settings_are_refused() {
        let good = || settings(ControlLaw::OpenLoop);
        let no_gain = SensorScale { gain: 0.0, offset: 0.0 };
        assert!(ControlLoop::new(ControlSettings { sensor_scale: no_gain, ..good() }).is_err());
        assert!(ControlLoop::new(ControlSettings { trim: f64::NAN, ..good() }).is_err());
        assert!(ControlLoop::new(ControlSettings { full_scale_v: 0.0, ..good() }).is_err());
        assert!(ControlLoop::new(ControlSettings { sample_time_s: -1.0, ..good() }).is_err());
    }
}
