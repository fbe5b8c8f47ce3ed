/// One number of an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// Its name, with the unit where it has one.
    pub name: &'static str,
    /// Its key in scenario files, where angles are in degrees.
    pub key: &'static str,
    /// Its SI unit; `1` for a pure number.
    pub unit: &'static str,
    /// The value at which the effect is the identity. Where another parameter of the effect decides that alone (a
    /// probability of 0), a typical value.
    pub neutral: f64,
    /// The least value that is allowed.
    pub lo: f64,
    /// The greatest value that is allowed.
    pub hi: f64,
    /// A typical value, for a fit to start from.
    pub start: f64,
    /// The value where a scenario file leaves it out, in the unit of the file; `None` where it must be given.
    pub default: Option<f64>,
    /// Its part in the effect, which decides how a fit treats it.
    pub role: Role,
}

/// The part of a parameter in its effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Role {
    /// How strong the effect is. Two effects of one kind and place add up in it.
    Strength,
    /// A strength that is right or wrong, such as the step of a quantization: it is taken as found, not fitted.
    Step,
    /// How the effect depends on range, angle or time. The prior is for a shape that a log may tell little about.
    Shape(Option<Prior>),
    /// Where the effect is. No position is neutral, so that the first step of a fit is given, in the parameter's unit.
    /// The likelihood isn't smooth in it: beams enter and leave one by one.
    Position {
        /// First step of a fit.
        first_step: f64,
    },
}

/// Prior of a shape about its typical value.
///
/// A log may tell little about a shape, and another parameter then makes up for it: losses that set in slowly at a steep
/// angle look like losses that set in fast at a flatter one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Prior {
    /// The value is normal.
    Normal {
        /// Standard deviation, in the parameter's unit.
        sd: f64,
    },
    /// ln(value + offset) is normal.
    LogNormal {
        /// Added before the logarithm, for a value that may be 0.
        offset: f64,
        /// Standard deviation of the logarithm.
        sd: f64,
    },
}

impl Prior {
    /// How many standard deviations `value` is above `about`.
    pub fn deviations(&self, value: f64, about: f64) -> f64 {
        match *self {
            Self::Normal { sd } => (value - about) / sd,
            Self::LogNormal { offset, sd } => {
                let ln = |value: f64| (value + offset).max(1e-6).ln();
                (ln(value) - ln(about)) / sd
            }
        }
    }
}

impl Parameter {
    /// A strength: its name, SI unit, neutral value, limits, a typical value.
    pub(super) const fn strength(
        name: &'static str,
        unit: &'static str,
        neutral: f64,
        [lo, hi]: [f64; 2],
        start: f64,
    ) -> Self {
        Self { name, key: name, unit, neutral, lo, hi, start, default: None, role: Role::Strength }
    }

    /// A probability `p`, neutral at 0.
    pub(super) const fn probability(start: f64) -> Self {
        Self::strength("p", "1", 0.0, [0.0, 1.0], start)
    }

    /// A strength that isn't fitted, neutral at 0: its name, SI unit, limits, a typical value.
    pub(super) const fn step(name: &'static str, unit: &'static str, limits: [f64; 2], start: f64) -> Self {
        Self { role: Role::Step, ..Self::strength(name, unit, 0.0, limits, start) }
    }

    /// A shape: its name, SI unit, limits, a typical value.
    pub(super) const fn shape(name: &'static str, unit: &'static str, limits: [f64; 2], start: f64) -> Self {
        Self { role: Role::Shape(None), ..Self::strength(name, unit, start, limits, start) }
    }

    /// A position: its name, SI unit, limits, a value to start from, the first step of a fit.
    pub(super) const fn position(
        name: &'static str,
        unit: &'static str,
        limits: [f64; 2],
        start: f64,
        first_step: f64,
    ) -> Self {
        Self { role: Role::Position { first_step }, ..Self::strength(name, unit, start, limits, start) }
    }

    /// With another key in files.
    pub(super) const fn key(self, key: &'static str) -> Self {
        Self { key, ..self }
    }

    /// With a value for files that leave it out, in the unit of the file.
    pub(super) const fn default(self, default: f64) -> Self {
        Self { default: Some(default), ..self }
    }

    /// A shape with a prior.
    pub(super) const fn prior(self, prior: Prior) -> Self {
        Self { role: Role::Shape(Some(prior)), ..self }
    }

    /// Whether it says how strong the effect is.
    pub fn is_strength(&self) -> bool {
        matches!(self.role, Role::Strength | Role::Step)
    }

    /// A change of a value that shows: how far the value is from neutral, no less than 0.3 of what is typical. For a parameter whose
    /// typical value is the neutral one, a twentieth of its range.
    pub fn typical_step(&self, value: f64) -> f64 {
        let away = (value - self.neutral).abs().max(0.3 * (self.start - self.neutral).abs());
        if away == 0.0 { 0.05 * (self.hi - self.lo) } else { away }
    }

    /// First step of a search that starts at `value`.
    pub fn first_step(&self, value: f64) -> f64 {
        if let Role::Position { first_step } = self.role {
            return first_step;
        }
        if self.is_extra() && self.lo >= 0.0 {
            return 0.05 * (self.hi - self.lo);
        }
        if self.lo >= 0.0 {
            // A parameter that can't be negative is searched by its logarithm; this is the least value that one starts from.
            return 1e-3 * (self.start - self.lo).abs().max(1e-3);
        }
        // Towards the neutral value first, on either side of it.
        if value < self.neutral { -self.typical_step(value) } else { self.typical_step(value) }
    }

    /// Whether an effect does without it where a file leaves it out, as a wall does without a turn.
    pub fn is_extra(&self) -> bool {
        matches!(self.role, Role::Shape(_)) && self.default == Some(0.0) && self.start == 0.0
    }

    /// The prior of a shape that a log may tell little about.
    pub fn shape_prior(&self) -> Option<Prior> {
        match self.role {
            Role::Shape(prior) => prior,
            _ => None,
        }
    }
}
