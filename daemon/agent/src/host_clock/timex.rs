//! `adjtimex(2)`, read only. No maintained crate wraps the reading of the error bounds safely.

use std::io;
use std::mem::MaybeUninit;

/// State of the clock's error from `adjtimex`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Timex {
    /// `true` if a daemon keeps the clock synchronised (`STA_UNSYNC` is not set).
    pub(super) is_synchronised: bool,
    /// `maxerror` in microseconds.
    pub(super) max_error_us: i64,
    /// `esterror` in microseconds.
    pub(super) estimated_error_us: i64,
}

/// Reads the state of the kernel's clock. Needs no privilege.
pub(super) fn read() -> io::Result<Timex> {
    #[expect(unsafe_code, reason = "libc's adjtimex has no safe wrapper")]
    // SAFETY: `timex` consists of integers, for which all bits zero is a valid value. The pointer is to a complete
    // structure on our stack. Its field `modes` is zero, so that the call only fills in the structure and changes
    // nothing.
    let (state, timex) = unsafe {
        let mut timex = MaybeUninit::<libc::timex>::zeroed();
        let state = libc::adjtimex(timex.as_mut_ptr());
        (state, timex.assume_init())
    };
    if state < 0 {
        return Err(io::Error::last_os_error());
    }
    Ok(Timex {
        is_synchronised: timex.status & libc::STA_UNSYNC == 0 && state != libc::TIME_ERROR,
        #[allow(clippy::useless_conversion, reason = "the fields are narrower on 32-bit machines")]
        max_error_us: i64::from(timex.maxerror),
        #[allow(clippy::useless_conversion, reason = "the fields are narrower on 32-bit machines")]
        estimated_error_us: i64::from(timex.esterror),
    })
}
