//! Custom instruments.

use crate::{Name, Unit};

/// An instrument that measures a quantity between two times, for example energy, a rise of temperature, or cache
/// misses.
///
/// ```
/// # use std::sync::Arc;
/// # use peernet_clock::{ClockIdentity, ManualClock, WallTime};
/// # use peernet_logger::{HostId, Meter, Name, Recorder, Unit, stage};
/// /// Counts joules. A real instrument reads a file of the kernel.
/// struct Energy {
///     joules: f64,
///     before: f64,
/// }
///
/// impl Meter for Energy {
///     fn kind(&self) -> Name {
///         Name::from_static("energy")
///     }
///     fn unit(&self) -> Unit {
///         Unit::JOULES
///     }
///     fn begin(&mut self) {
///         self.before = self.joules;
///     }
///     fn end(&mut self) -> f64 {
///         self.joules - self.before
///     }
/// }
///
/// # let clock = Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("b", "c")));
/// # let mut log = Recorder::new(clock, HostId::random());
/// let mut battery = Energy { joules: 100.0, before: 0.0 };
/// {
///     let mut board = log.measure(Name::from_static("board"), &mut battery);
///     board.meter().joules += 1.5;
/// }
/// let tree = log.finish();
/// let board = &tree.find(&["board"]).unwrap().1.measure;
/// assert_eq!((board.kind().as_str(), board.value(), board.unit()), ("energy", Some(1.5), Unit::JOULES));
/// ```
pub trait Meter {
    /// Returns the kind of the instrument's nodes ([`Measure::kind`](crate::Measure::kind)), such as `energy`.
    fn kind(&self) -> Name;

    /// Returns the unit of the measured values.
    fn unit(&self) -> Unit;

    /// Starts measuring.
    fn begin(&mut self);

    /// Stops measuring. Returns the measured value; NaN if the instrument could not be read.
    fn end(&mut self) -> f64;
}

impl<M: Meter + ?Sized> Meter for &mut M {
    fn kind(&self) -> Name {
        (**self).kind()
    }

    fn unit(&self) -> Unit {
        (**self).unit()
    }

    fn begin(&mut self) {
        (**self).begin();
    }

    fn end(&mut self) -> f64 {
        (**self).end()
    }
}
