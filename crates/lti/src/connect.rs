//! Interconnection by named signals: blocks, sums and the names that join them.

use nalgebra::DMatrix;

use crate::interconnect::Wiring;
use crate::{Error, GeneralizedPlant, StateSpace, TimeDomain};

mod signal;
pub use signal::Signal;
use signal::{Reference, SumExpression};

/// A block diagram under construction: signals of the same name are one signal.
///
/// ```text
///                 d
///                 |
///    r      e     v    u         y
///   --->(+)---> [ K ] ---> [ G ] --+--->     sum("e = r - y"), block(k, ["e"], ["u"]), block(g, ["u"], ["y"])
///        ^ -                       |
///        +-------------------------+
/// ```
///
/// A signal is *made* once: by a block's output, by a sum, or by an external input; it may be *read* any number of times, by block
/// inputs, sums and external outputs. What is made has a name and a width (`"y"`, or `("y", 2)` for a vector). What is read
/// is a whole signal (`"y"`), one channel of it (`"y[1]"`, from zero) or some (`"y[0..2]"`, the end excluded).
///
/// **Shapes and units**: a single name without a width stands for all outputs of its block; among several names, a name without
/// a width is one channel. The widths of what a block reads must add up to its inputs.
///
/// **Method**: all blocks side by side, sums as blocks without states, closed in one step by [`Wiring`]. Every block's states appear
/// once, in the order in which the blocks were added.
///
/// **Errors** are reported by [`Diagram::connect`].
///
/// **Example**
/// ```
/// use telepulse_lti::{Diagram, TransferFunction};
/// let g = TransferFunction::new(&[2.0], &[1.0, 1.0])?.to_state_space();
/// let k = TransferFunction::new(&[3.0], &[1.0, 0.0])?.to_state_space();
/// let closed = Diagram::new()
///     .external_inputs(["r"])
///     .sum("e = r - y")
///     .block(&k, ["e"], ["u"])
///     .block(&g, ["u"], ["y"])
///     .external_outputs(["y", "u"])
///     .connect()?;
/// let gains = closed.sys().dc_gain()?;
/// assert!((gains[(0, 0)] - 1.0).abs() < 1e-15 && (gains[(1, 0)] - 0.5).abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Diagram<'a, D: TimeDomain> {
    blocks: Vec<Block<'a, D>>,
    sums: Vec<String>,
    inputs: Vec<Signal>,
    outputs: Vec<String>,
    open: Vec<String>,
}

#[derive(Clone, Debug)]
struct Block<'a, D: TimeDomain> {
    sys: &'a StateSpace<D>,
    reads: Vec<String>,
    makes: Vec<Signal>,
}

impl<D: TimeDomain> Default for Diagram<'_, D> {
    fn default() -> Self {
        Self::new()
    }
}

impl<'a, D: TimeDomain> Diagram<'a, D> {
    /// A diagram without blocks.
    #[must_use]
    pub fn new() -> Self {
        Self { blocks: vec![], sums: vec![], inputs: vec![], outputs: vec![], open: vec![] }
    }

    /// Adds a system that reads the signals `reads` at its inputs and makes the signals `makes` at its outputs.
    #[must_use]
    pub fn block<R, M>(mut self, sys: &'a StateSpace<D>, reads: R, makes: M) -> Self
    where
        R: IntoIterator<Item: Into<String>>,
        M: IntoIterator<Item: Into<Signal>>,
    {
        let (reads, makes) = (reads.into_iter().map(Into::into), makes.into_iter().map(Into::into));
        self.blocks.push(Block { sys, reads: reads.collect(), makes: makes.collect() });
        self
    }

    /// Adds a system by the names that it carries itself.
    #[must_use]
    pub fn named_block(self, named: &'a NamedSystem<D>) -> Self {
        let reads: Vec<String> = named.inputs.iter().map(|signal| signal.name().to_owned()).collect();
        self.block(&named.sys, reads, named.outputs.clone())
    }

    /// Adds a sum such as `"e = r - y"`; terms may carry a factor, as in `"v = 0.5*a - b[1] + 2*c[0]"`.
    ///
    /// All terms have the same width, which is that of the sum.
    #[must_use]
    pub fn sum(mut self, expression: impl Into<String>) -> Self {
        self.sums.push(expression.into());
        self
    }

    /// Adds signals that come from outside; they are the inputs of the result, in this order.
    #[must_use]
    pub fn external_inputs<M: IntoIterator<Item: Into<Signal>>>(mut self, signals: M) -> Self {
        self.inputs.extend(signals.into_iter().map(Into::into));
        self
    }

    /// Adds signals that are seen from outside; they are the outputs of the result, in this order.
    #[must_use]
    pub fn external_outputs<R: IntoIterator<Item: Into<String>>>(mut self, signals: R) -> Self {
        self.outputs.extend(signals.into_iter().map(Into::into));
        self
    }

    /// States that nothing reads these signals, which would be an error otherwise.
    #[must_use]
    pub fn leave_open<R: IntoIterator<Item: Into<String>>>(mut self, signals: R) -> Self {
        self.open.extend(signals.into_iter().map(Into::into));
        self
    }

    /// The system that the diagram describes, with its names.
    ///
    /// # Errors
    /// [`Error::SignalName`] and [`Error::SumExpression`] for what cannot be read; [`Error::UnknownSignal`] for a name that
    /// nothing makes, [`Error::DuplicateSignal`] for one that is made twice, [`Error::UnconnectedSignal`] for one that nothing
    /// reads; [`Error::SignalWidth`], [`Error::SignalIndex`]; [`Error::SignalLoop`] for an algebraic loop, with the signals in
    /// it; [`Error::SampleTimeMismatch`]; [`Error::NoBlocks`], [`Error::NoPorts`].
    pub fn connect(&self) -> Result<NamedSystem<D>, Error> {
        let Some(first) = self.blocks.first() else { return Err(Error::NoBlocks) };
        if self.inputs.is_empty() || self.outputs.is_empty() {
            return Err(Error::NoPorts { n_inputs: self.inputs.len(), n_outputs: self.outputs.len() });
        }
        let sums = self.sums.iter().map(|text| SumExpression::parse(text)).collect::<Result<Vec<_>, _>>()?;
        let mut table = Table::new(self, &sums)?;

        // Rows of the side-by-side system's inputs, as channels that they read; sums and externals are static blocks.
        let domain = *first.sys.domain();
        let mut all = first.sys.clone();
        let mut reads = table.read_all(&first.reads, "a block", first.sys.n_inputs())?;
        for block in &self.blocks[1..] {
            all = all.augment(block.sys)?;
            reads.extend(table.read_all(&block.reads, "a block", block.sys.n_inputs())?);
        }
        for sum in &sums {
            let width = table.width_of(&sum.makes)?;
            let mut gain = DMatrix::zeros(width, width * sum.terms.len());
            for (k, term) in sum.terms.iter().enumerate() {
                gain.view_mut((0, k * width), (width, width)).fill_diagonal(term.factor);
                reads.extend(table.read(&term.reference, &sum.makes)?);
            }
            all = all.augment(&static_gain(gain, domain)?)?;
        }
        let n_external: usize = self.inputs.iter().map(|signal| signal.width_or(1)).sum();
        let first_external = reads.len();
        all = all.augment(&static_gain(DMatrix::identity(n_external, n_external), domain)?)?;

        let mut seen = Vec::new();
        let mut outputs = Vec::new();
        for text in &self.outputs {
            let channels = table.read(&Reference::parse(text)?, "an external output")?;
            outputs.push(Signal::from((text.as_str(), channels.len())));
            seen.extend(channels);
        }
        table.check_all_read(&self.open)?;

        let (n_v, n_y) = (all.n_inputs(), all.n_outputs());
        let mut feedback = DMatrix::zeros(n_v, n_y);
        for (row, &channel) in reads.iter().enumerate() {
            feedback[(row, channel)] = 1.0;
        }
        let mut external = DMatrix::zeros(n_v, n_external);
        external.view_mut((first_external, 0), (n_external, n_external)).fill_with_identity();
        let mut chosen = DMatrix::zeros(seen.len(), n_y);
        for (row, &channel) in seen.iter().enumerate() {
            chosen[(row, channel)] = 1.0;
        }
        let sys = match all.close_loop(&Wiring { feedback: feedback.clone(), external, outputs: chosen }) {
            Err(Error::AlgebraicLoop { smallest_singular_value, threshold }) => {
                let signals = table.loop_signals(&(all.d() * feedback));
                return Err(Error::SignalLoop { signals, smallest_singular_value, threshold });
            }
            other => other?,
        };
        let inputs =
            self.inputs.iter().map(|signal| Signal::from((signal.name(), signal.width_or(1)))).collect();
        Ok(NamedSystem { sys, inputs, outputs })
    }
}

fn static_gain<D: TimeDomain>(gain: DMatrix<f64>, domain: D) -> Result<StateSpace<D>, Error> {
    let (n_y, n_u) = gain.shape();
    StateSpace::with_domain(
        DMatrix::zeros(0, 0),
        DMatrix::zeros(0, n_u),
        DMatrix::zeros(n_y, 0),
        gain,
        domain,
    )
}

/// Where each signal lies among the outputs of the side-by-side system, and whether something reads it.
struct Table {
    entries: Vec<Entry>,
}

struct Entry {
    name: String,
    first: usize,
    width: usize,
    is_read: bool,
}

impl Table {
    /// Signals in the order blocks, sums, external inputs.
    fn new<D: TimeDomain>(diagram: &Diagram<'_, D>, sums: &[SumExpression]) -> Result<Self, Error> {
        let mut table = Self { entries: Vec::new() };
        let mut first = 0;
        for block in &diagram.blocks {
            let alone = if block.makes.len() == 1 { block.sys.n_outputs() } else { 1 };
            let found: usize = block.makes.iter().map(|signal| signal.width_or(alone)).sum();
            if found != block.sys.n_outputs() {
                let names: Vec<&str> = block.makes.iter().map(Signal::name).collect();
                return Err(Error::SignalWidth {
                    signal: names.join(", "),
                    place: "the outputs of a block".to_owned(),
                    expected: block.sys.n_outputs(),
                    found,
                });
            }
            for signal in &block.makes {
                table.insert(signal.name(), &mut first, signal.width_or(alone))?;
            }
        }
        let mut unresolved: Vec<usize> = (0..sums.len()).collect();
        let mut widths = vec![0; sums.len()];
        // External inputs come last but their widths are needed for those of the sums.
        let width_of = |name: &str, table: &Self, widths: &[usize]| {
            let external = diagram.inputs.iter().find(|signal| signal.name() == name);
            let sum = sums.iter().position(|sum| sum.makes == name);
            external
                .map(|signal| signal.width_or(1))
                .or_else(|| table.entries.iter().find(|entry| entry.name == name).map(|entry| entry.width))
                .or_else(|| sum.map(|k| widths[k]))
        };
        // Each pass settles at least one sum, or none ever will.
        for _ in 0..sums.len() {
            unresolved.retain(|&k| {
                let width = sums[k].terms.iter().find_map(|term| {
                    let whole = width_of(&term.reference.name, &table, &widths)?;
                    (whole > 0).then(|| term.reference.range.map_or(whole, |(from, to)| to - from))
                });
                widths[k] = width.unwrap_or(0);
                widths[k] == 0
            });
        }
        if let Some(&k) = unresolved.first() {
            // Either a name that nothing makes, or sums that only know each other.
            for term in &sums[k].terms {
                let name = &term.reference.name;
                if width_of(name, &table, &widths).is_none() {
                    return Err(Error::UnknownSignal { signal: name.clone(), place: sums[k].makes.clone() });
                }
            }
            let signals = unresolved.iter().map(|&k| sums[k].makes.clone()).collect();
            return Err(Error::SignalLoop { signals, smallest_singular_value: 0.0, threshold: 0.0 });
        }
        for (sum, &width) in sums.iter().zip(&widths) {
            table.insert(&sum.makes, &mut first, width)?;
        }
        for signal in &diagram.inputs {
            table.insert(signal.name(), &mut first, signal.width_or(1))?;
        }
        for sum in sums {
            let expected = table.width_of(&sum.makes)?;
            for term in &sum.terms {
                let found = table.channels(&term.reference, &sum.makes)?.len();
                if found != expected {
                    let (signal, place) = (term.reference.name.clone(), format!("the sum {}", sum.makes));
                    return Err(Error::SignalWidth { signal, place, expected, found });
                }
            }
        }
        Ok(table)
    }

    fn insert(&mut self, name: &str, first: &mut usize, width: usize) -> Result<(), Error> {
        signal::check_name(name)?;
        if width == 0 {
            let (signal, place) = (name.to_owned(), "its declaration".to_owned());
            return Err(Error::SignalWidth { signal, place, expected: 1, found: 0 });
        }
        if self.entries.iter().any(|entry| entry.name == name) {
            return Err(Error::DuplicateSignal { signal: name.to_owned() });
        }
        self.entries.push(Entry { name: name.to_owned(), first: *first, width, is_read: false });
        *first += width;
        Ok(())
    }

    fn position(&self, name: &str, place: &str) -> Result<usize, Error> {
        let position = self.entries.iter().position(|entry| entry.name == name);
        position.ok_or_else(|| Error::UnknownSignal { signal: name.to_owned(), place: place.to_owned() })
    }

    fn width_of(&self, name: &str) -> Result<usize, Error> {
        Ok(self.entries[self.position(name, name)?].width)
    }

    fn channels(&self, reference: &Reference, place: &str) -> Result<std::ops::Range<usize>, Error> {
        let entry = &self.entries[self.position(&reference.name, place)?];
        let (from, to) = reference.range.unwrap_or((0, entry.width));
        if to > entry.width {
            let signal = reference.name.clone();
            return Err(Error::SignalIndex { signal, width: entry.width, index: to - 1 });
        }
        Ok(entry.first + from..entry.first + to)
    }

    /// The channels of a reference, which counts as read from now on.
    fn read(&mut self, reference: &Reference, place: &str) -> Result<std::ops::Range<usize>, Error> {
        let channels = self.channels(reference, place)?;
        let position = self.position(&reference.name, place)?;
        self.entries[position].is_read = true;
        Ok(channels)
    }

    /// The channels that a block reads, as many as it has inputs.
    fn read_all(&mut self, texts: &[String], place: &str, expected: usize) -> Result<Vec<usize>, Error> {
        let mut channels = Vec::new();
        for text in texts {
            channels.extend(self.read(&Reference::parse(text)?, place)?);
        }
        if channels.len() != expected {
            let (signal, place) = (texts.join(", "), "the inputs of a block".to_owned());
            return Err(Error::SignalWidth { signal, place, expected, found: channels.len() });
        }
        Ok(channels)
    }

    fn check_all_read(&self, open: &[String]) -> Result<(), Error> {
        for name in open {
            self.position(name, "the signals left open")?;
        }
        let idle = self.entries.iter().find(|entry| !entry.is_read && !open.contains(&entry.name));
        match idle {
            Some(entry) => Err(Error::UnconnectedSignal { signal: entry.name.clone() }),
            None => Ok(()),
        }
    }

    /// The signals that take part in the singular direction of `I - loop_gain`.
    fn loop_signals(&self, loop_gain: &DMatrix<f64>) -> Vec<String> {
        let n = loop_gain.nrows();
        let svd = (DMatrix::identity(n, n) - loop_gain).svd(false, true);
        let smallest = svd.singular_values.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1));
        let (Some((index, _)), Some(v_t)) = (smallest, svd.v_t) else { return Vec::new() };
        let direction = v_t.row(index).into_owned();
        let moves = |entry: &&Entry| {
            direction.columns(entry.first, entry.width).amax() > LOOP_SHARE * direction.amax()
        };
        self.entries.iter().filter(moves).map(|entry| entry.name.clone()).collect()
    }
}

/// A signal takes part in an algebraic loop where it moves by at least this share of the largest in the loop.
const LOOP_SHARE: f64 = 1e-6;

/// A system whose inputs and outputs have names.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedSystem<D: TimeDomain> {
    sys: StateSpace<D>,
    inputs: Vec<Signal>,
    outputs: Vec<Signal>,
}

impl<D: TimeDomain> NamedSystem<D> {
    /// The system, its ports in the order of the names.
    #[must_use]
    pub fn sys(&self) -> &StateSpace<D> {
        &self.sys
    }

    /// Names and widths of the inputs.
    #[must_use]
    pub fn inputs(&self) -> &[Signal] {
        &self.inputs
    }

    /// Names and widths of the outputs; a part of a signal is named as it was asked for, such as `y[1]`.
    #[must_use]
    pub fn outputs(&self) -> &[Signal] {
        &self.outputs
    }

    /// The transfer function matrix from some inputs to some outputs.
    ///
    /// # Errors
    /// [`Error::UnknownSignal`], [`Error::NoPorts`].
    pub fn from_to(&self, inputs: &[&str], outputs: &[&str]) -> Result<StateSpace<D>, Error> {
        let (inputs, outputs) = (ports(&self.inputs, inputs)?, ports(&self.outputs, outputs)?);
        self.sys.select(&outputs, &inputs)
    }

    /// The generalized plant with these control inputs and measured outputs; `w` and `z` are all others, in their order.
    ///
    /// # Errors
    /// [`Error::UnknownSignal`], [`Error::PortCount`] where a group is empty.
    ///
    /// # Example
    /// ```
    /// use telepulse_lti::{Diagram, TransferFunction};
    /// let g = TransferFunction::new(&[2.0], &[1.0, 1.0])?.to_state_space();
    /// let plant = Diagram::new()
    ///     .external_inputs(["r", "u"])
    ///     .block(&g, ["u"], ["y"])
    ///     .sum("e = r - y")
    ///     .sum("z = e")
    ///     .external_outputs(["z", "e"])
    ///     .connect()?
    ///     .generalized_plant(&["u"], &["e"])?;
    /// assert_eq!((plant.n_w(), plant.d12()[(0, 0)], plant.d21()[(0, 0)]), (1, 0.0, 1.0));
    /// # Ok::<(), telepulse_lti::Error>(())
    /// ```
    pub fn generalized_plant(&self, u: &[&str], y: &[&str]) -> Result<GeneralizedPlant<D>, Error> {
        let (u, y) = (ports(&self.inputs, u)?, ports(&self.outputs, y)?);
        let mut inputs: Vec<usize> = (0..self.sys.n_inputs()).filter(|k| !u.contains(k)).collect();
        let mut outputs: Vec<usize> = (0..self.sys.n_outputs()).filter(|k| !y.contains(k)).collect();
        let (n_w, n_z) = (inputs.len(), outputs.len());
        inputs.extend(&u);
        outputs.extend(&y);
        GeneralizedPlant::new(self.sys.select(&outputs, &inputs)?, n_w, u.len(), n_z, y.len())
    }
}

/// Indices of the ports with these names.
fn ports(signals: &[Signal], names: &[&str]) -> Result<Vec<usize>, Error> {
    let mut indices = Vec::new();
    for &name in names {
        let mut first = 0;
        let mut found = None;
        for signal in signals {
            let width = signal.width_or(1);
            if signal.name() == name {
                found = Some(first..first + width);
                break;
            }
            first += width;
        }
        let unknown =
            || Error::UnknownSignal { signal: name.to_owned(), place: "a choice of ports".to_owned() };
        indices.extend(found.ok_or_else(unknown)?);
    }
    Ok(indices)
}

#[cfg(test)]
mod tests;
