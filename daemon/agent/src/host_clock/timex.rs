//! `adjtimex(2)`, for reading only. No crate that is kept up wraps the reading of the error bounds.

use std::io;
use std::mem::MaybeUninit;

/// What `adjtimex` tells of the clock's error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Timex {
    /// Whether a daemon keeps the clock right (`STA_UNSYNC` is not set).
    pub(super) synchronised: bool,
    /// `maxerror`, microseconds.
    pub(super) max_error_us: i64,
    /// `esterror`, microseconds.
    pub(super) estimated_error_us: i64,
}

/// Reads the state of the kernel's clock; needs no privilege.
pub(super) fn read() -> io::Result<Timex> {
    #[expect(unsafe_code, reason = "libc's adjtimex has no safe wrapper")]
    // SAFETY: `timex` is made of integers, for which all bits zero is a value; the pointer is to a whole one of our
    // own. `modes` is then zero, with which the call changes nothing but fills it in.
    let (state, timex) = unsafe {
        let mut timex = MaybeUninit::<libc::timex>::zeroed();
        let state = libc::adjtimex(timex.as_mut_ptr());
        (state, timex.assume_init())
    };
    if state < 0 {
        return Err(io::Error::last_os_error());
    }
    Ok(Timex {
        synchronised: timex.status & libc::STA_UNSYNC == 0 && state != libc::TIME_ERROR,
        #[allow(clippy::useless_conversion, reason = "the fields are narrower on 32-bit machines")]
        max_error_us: i64::from(timex.maxerror),
        #[allow(clippy::useless_conversion, reason = "the fields are narrower on 32-bit machines")]
        estimated_error_us: i64::from(timex.esterror),
    })
}
