//! Clocks with a simulated faulty oscillator, which a preloaded library shows to a process.
//!
//! The process cannot detect the error. The test schedules each change of the error, and knows the error at each time to
//! the nanosecond.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex, PoisonError};

use peernet_clock::{Clock, ClockIdentity, RawTime, Span, SystemClock};

/// Time between scheduling a change and its start. It is long enough that the change is written to the file before a
/// process reads a clock after the start.
const CHANGE_LEAD_TIME: Span = Span::from_millis(200);

/// Size of a segment in the file, bytes.
const SEGMENT_BYTES: usize = 32;
/// Size of the field with the number of segments, at the start of the file, bytes.
const COUNT_BYTES: usize = 8;
/// Maximum number of segments that the library reads.
const MAX_SEGMENTS: usize = 255;

/// Error of the clocks from `begin` to the beginning of the next segment.
#[derive(Clone, Copy, Debug)]
struct Segment {
    begin: RawTime,
    /// Error at `begin`; positive if the clocks are ahead.
    ahead: Span,
    /// Rate of the error, nanoseconds per nanosecond.
    rate: f64,
    /// Change of the rate, per nanosecond.
    rate_change: f64,
}

impl Segment {
    /// Returns the error of the clocks at a true time.
    fn ahead_at(&self, truth: RawTime) -> Span {
        let elapsed = (truth - self.begin).nanos() as f64;
        self.ahead
            + Span::from_nanos((elapsed * (self.rate + self.rate_change * elapsed / 2.0)).round() as i64)
    }

    fn bytes(&self) -> [u8; SEGMENT_BYTES] {
        let words = [
            self.begin.nanos().to_ne_bytes(),
            self.ahead.nanos().to_ne_bytes(),
            self.rate.to_ne_bytes(),
            self.rate_change.to_ne_bytes(),
        ];
        let mut bytes = [0; SEGMENT_BYTES];
        bytes.as_chunks_mut().0.copy_from_slice(&words);
        bytes
    }
}

/// Error of the clocks at each time.
#[derive(Clone, Debug, Default)]
pub struct ClockErrors(Arc<Mutex<Vec<Segment>>>);

impl ClockErrors {
    fn segments(&self) -> Vec<Segment> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the times of the machine's free-running clock at which the faulty clock showed `shown`. There may be several,
    /// because a clock that was set back shows some times twice.
    pub fn truths(&self, shown: RawTime) -> Vec<RawTime> {
        let segments = self.segments();
        let before_first_change = Segment {
            begin: RawTime::from_nanos(i64::MIN / 2),
            ahead: Span::ZERO,
            rate: 0.0,
            rate_change: 0.0,
        };
        let segments: Vec<Segment> = std::iter::once(before_first_change).chain(segments).collect();
        let ends = segments.iter().skip(1).map(|next| next.begin).chain([RawTime::from_nanos(i64::MAX)]);
        let truth = |(segment, end): (&Segment, RawTime)| {
            let mut truth = shown - segment.ahead;
            // The rate is far below one, so the iteration converges quickly.
            for _ in 0..8 {
                truth = shown - segment.ahead_at(truth);
            }
            (segment.begin <= truth && truth < end).then_some(truth)
        };
        segments.iter().zip(ends).filter_map(truth).collect()
    }
}

/// Faulty clocks for processes that are started with its [`environment`](Self::environment). They have no error until
/// the first change.
#[derive(Debug)]
pub struct ClockShim {
    library: String,
    schedule: PathBuf,
    file: File,
    clock: SystemClock,
    errors: ClockErrors,
}

impl ClockShim {
    /// Creates a folder and builds the library in it.
    ///
    /// # Panics
    /// If there is no C compiler.
    pub fn new(folder: &Path) -> Self {
        std::fs::create_dir_all(folder).expect("the temporary folder is writable");
        let (library, source) =
            (folder.join("shim.so"), concat!(env!("CARGO_MANIFEST_DIR"), "/src/clock_shim/shim.c"));
        let compiler_output = Command::new("cc")
            .args(["-shared", "-fPIC", "-O2", "-Wall", "-Werror", source, "-o"])
            .arg(&library)
            .args(["-lm", "-ldl"])
            .output()
            .expect("the C compiler that Rust links with is installed");
        assert!(compiler_output.status.success(), "{}", String::from_utf8_lossy(&compiler_output.stderr));
        let schedule = folder.join("schedule");
        let file = File::create(&schedule).expect("the temporary folder is writable");
        file.set_len((COUNT_BYTES + MAX_SEGMENTS * SEGMENT_BYTES) as u64)
            .expect("the disk has space for 8 kB");
        Self {
            library: library.display().to_string(),
            schedule,
            file,
            clock: SystemClock::new(ClockIdentity::new("boot", "system")),
            errors: ClockErrors::default(),
        }
    }

    /// Returns the environment variables for a process that should see these clocks. Waits for the start of the first
    /// change, if one is scheduled, so that the process does not see the clocks without it.
    ///
    /// # Panics
    /// If the folder's name is not Unicode.
    pub fn environment(&self) -> [(&str, &str); 2] {
        if let Some(first) = self.errors.segments().first() {
            std::thread::sleep((first.begin - self.now()).to_duration());
        }
        let schedule = self.schedule.to_str().expect("the name of a temporary folder is ASCII");
        [("LD_PRELOAD", &self.library), ("PEERNET_TEST_CLOCK", schedule)]
    }

    /// Returns the errors, including those of future changes.
    pub fn errors(&self) -> ClockErrors {
        self.errors.clone()
    }

    /// Returns the time of the machine's free-running clock.
    pub fn now(&self) -> RawTime {
        self.clock.raw()
    }

    /// Schedules a change shortly after now: the clocks step forward by `step` and run fast by `ppm`, which grows by
    /// `ppm_per_s` each second. Returns the start of the change.
    pub fn schedule_change(&self, step: Span, ppm: f64, ppm_per_s: f64) -> RawTime {
        self.schedule_change_at(self.now() + CHANGE_LEAD_TIME, step, ppm, ppm_per_s)
    }

    /// Schedules a change like [`schedule_change`](Self::schedule_change) at `begin`, which must be in the future and after
    /// the last change.
    ///
    /// # Panics
    /// If `begin` is in the past or not after the last change, or if the schedule is full.
    pub fn schedule_change_at(&self, begin: RawTime, step: Span, ppm: f64, ppm_per_s: f64) -> RawTime {
        let mut segments = self.errors.0.lock().unwrap_or_else(PoisonError::into_inner);
        let last = segments.last();
        assert!(last.is_none_or(|last| last.begin < begin), "a change must be later than the one before");
        let ahead = last.map_or(Span::ZERO, |last| last.ahead_at(begin));
        // 1 ppm per second is 1e-15 per nanosecond.
        let segment =
            Segment { begin, ahead: ahead + step, rate: ppm * 1e-6, rate_change: ppm_per_s * 1e-15 };
        let number = segments.len();
        assert!(number < MAX_SEGMENTS, "a schedule has at most {MAX_SEGMENTS} changes");
        let offset = (COUNT_BYTES + number * SEGMENT_BYTES) as u64;
        let result = self.file.write_all_at(&segment.bytes(), offset);
        let result = result.and_then(|()| self.file.write_all_at(&(number as u64 + 1).to_ne_bytes(), 0));
        result.expect("the file has its full length");
        assert!(self.now() < begin, "the change was written after its start");
        segments.push(segment);
        begin
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn process_under_shim_sees_scheduled_errors() {
        let folder = tempfile::tempdir().expect("the temporary folder is writable");
        let shim = ClockShim::new(folder.path());
        let read_clock = || {
            let print_raw_clock = "import time; print(time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW))";
            let before = shim.now();
            let output =
                Command::new("python3").args(["-c", print_raw_clock]).envs(shim.environment()).output();
            let output = output.expect("python3 is installed").stdout;
            let shown: i64 = String::from_utf8_lossy(&output).trim().parse().expect("a number");
            let truths = shim.errors().truths(RawTime::from_nanos(shown));
            assert!(truths.iter().any(|truth| (before..shim.now()).contains(truth)), "{truths:?}");
            (before, RawTime::from_nanos(shown))
        };
        let (before, shown) = read_clock();
        assert!(shown > before);
        shim.schedule_change(Span::from_seconds(-600), 200.0, 3.0);
        let (before, shown) = read_clock();
        assert!(before - shown > Span::from_seconds(590));
    }

    #[test]
    fn inverse_of_shim_errors_returns_true_time() {
        let at = |seconds: i64| RawTime::from_nanos(seconds * 1_000_000_000);
        let segment = |begin, ahead, rate, rate_change| Segment { begin, ahead, rate, rate_change };
        let segments = [
            segment(at(10), Span::from_millis(3), 200e-6, -2e-15),
            segment(at(20), Span::from_seconds(-2), 0.0, 0.0),
        ];
        let errors = ClockErrors(Arc::new(Mutex::new(segments.to_vec())));
        for nanos in [10_000_000_000, 12_345_678_901, 17_900_000_000] {
            let truth = RawTime::from_nanos(nanos);
            let truths = errors.truths(truth + segments[0].ahead_at(truth));
            assert_eq!(truths.len(), 1, "{truths:?}");
            assert!((truths[0] - truth).abs() <= Span::from_nanos(1), "{truths:?}");
        }
        assert_eq!(errors.truths(at(5)), [at(5)]);
        assert_eq!(errors.truths(at(19)).len(), 2, "set back by two seconds");
        assert_eq!(errors.truths(at(30)), [at(32)]);
    }
}
