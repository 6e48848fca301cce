//! Room on the disks that are written to.

use std::path::Path;

use peernet_stream::Grade;

use super::{Finding, Places};

const SCARCE_BYTES: u64 = 1 << 30;
const NONE_BYTES: u64 = 100 << 20;

/// Room where the run writes. Where the folder is not there yet, the one above it tells.
pub(super) fn free(places: &Places) -> Vec<Finding> {
    places.folders.iter().map(|(purpose, folder)| of(purpose, folder)).collect()
}

pub(super) fn of(purpose: &str, folder: &Path) -> Finding {
    const ABOUT: &str = "free disk";
    let there =
        folder.ancestors().map(|path| if path.as_os_str().is_empty() { Path::new(".") } else { path });
    let Some(disk) = there.into_iter().find_map(|path| rustix::fs::statvfs(path).ok()) else {
        return Finding::unknown(
            ABOUT,
            format!("{} for the {purpose} cannot be looked at", folder.display()),
        );
    };
    let free = disk.f_bavail.saturating_mul(disk.f_frsize);
    let found = format!("{:.1} GiB for the {purpose}", free as f64 / f64::from(1 << 30));
    let advice = format!("make room at {}", folder.display());
    match free {
        ..NONE_BYTES => Finding::worse(ABOUT, Grade::Bad, found, advice),
        NONE_BYTES..SCARCE_BYTES => Finding::worse(ABOUT, Grade::Doubtful, found, advice),
        SCARCE_BYTES.. => Finding::good(ABOUT, found),
    }
}
