//! The one place that writes to the terminal; everything else goes through the log.

/// A result that the user asked for, on standard output.
pub fn say(text: impl std::fmt::Display) {
    #[expect(clippy::print_stdout, reason = "this is the place")]
    {
        println!("{text}");
    }
}

/// What went wrong, on standard error, before or after the log exists.
pub fn complain(text: impl std::fmt::Display) {
    #[expect(clippy::print_stderr, reason = "this is the place")]
    {
        eprintln!("{text}");
    }
}
