//! Free space of the disks to which a run writes.

use std::path::Path;

use peernet_stream::Grade;

use super::{Finding, InspectionSettings};

/// If fewer bytes are free, the grade is doubtful.
const DOUBTFUL_BELOW_BYTES: u64 = 1 << 30;
/// If fewer bytes are free, the grade is bad.
const BAD_BELOW_BYTES: u64 = 100 << 20;

/// Grades the free space for every path to which the run writes.
pub(super) fn free_space(settings: &InspectionSettings) -> Vec<Finding> {
    settings.written_paths.iter().map(|(purpose, path)| free_space_of(purpose, path)).collect()
}

/// Grades the free space at a path, or at its nearest existing parent.
fn free_space_of(purpose: &str, written_path: &Path) -> Finding {
    const ABOUT: &str = "free disk";
    let paths =
        written_path.ancestors().map(|path| if path.as_os_str().is_empty() { Path::new(".") } else { path });
    let Some(disk) = paths.into_iter().find_map(|path| rustix::fs::statvfs(path).ok()) else {
        return Finding::unknown(
            ABOUT,
            format!("the free space of {} for the {purpose} cannot be read", written_path.display()),
        );
    };
    // `f_bavail` leaves out the blocks that are reserved for the superuser.
    let free = disk.f_bavail.saturating_mul(disk.f_frsize);
    let found = format!("{:.1} GiB for the {purpose}", free as f64 / f64::from(1 << 30));
    let advice = format!("free disk space at {}", written_path.display());
    match free {
        ..BAD_BELOW_BYTES => Finding::graded(ABOUT, Grade::Bad, found, advice),
        BAD_BELOW_BYTES..DOUBTFUL_BELOW_BYTES => Finding::graded(ABOUT, Grade::Doubtful, found, advice),
        DOUBTFUL_BELOW_BYTES.. => Finding::good(ABOUT, found),
    }
}
