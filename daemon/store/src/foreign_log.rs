//! Detection of a log (`-wal`) that belongs to another database file.
//!
//! SQLite applies any write-ahead log that lies beside a database. If an operator replaces a database by a backup,
//! SQLite would apply the old file's log to the backup: the backup would be damaged, and the log would be lost.
//! Therefore each database has a random id in the header field that SQLite leaves to programs (`user_version`).
//! <https://www.sqlite.org/fileformat2.html#the_write_ahead_log>

use std::fs::File;
use std::io::{self, ErrorKind};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use sqlx::{AssertSqlSafe, SqliteConnection};
use uuid::Uuid;

use super::integrity::log_pages::{FRAME_BYTES, HEADER_BYTES, MAGIC, log_path, read_whole};
use super::integrity::pages::be32;

/// Offset of the id within page 1, which is also the offset within the file.
pub(crate) const ID_OFFSET: usize = 60;

/// The write-ahead log at the path belongs to another file, which was at the database's path before.
#[derive(Debug, thiserror::Error)]
#[error(
    "the write-ahead log {} belongs to another database, which was at this path before; move it beside that \
     database, or delete the log if nobody needs its contents", .0.display()
)]
pub struct ForeignLog(pub(crate) PathBuf);

/// Gives the file an id if the file has none.
///
/// Page 1 is written even if the file has an id, so that the write-ahead log contains the id. Commits that change only
/// other pages, such as the commits of an aggregator without agents, would not write page 1.
pub(crate) async fn assign_id(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    let id: i32 = sqlx::query_scalar("PRAGMA user_version").fetch_one(&mut *connection).await?;
    let id = if id == 0 { random_id() } else { id };
    sqlx::raw_sql(AssertSqlSafe(format!("PRAGMA user_version = {id}"))).execute(connection).await?;
    Ok(())
}

/// Gives a new id to a copy of a database. The copy has no write-ahead log, and no connection may have the copy open.
pub(crate) fn assign_new_id(file: &File) -> io::Result<()> {
    file.write_all_at(&random_id().to_be_bytes(), ID_OFFSET as u64)
}

fn random_id() -> i32 {
    // The id is not 0, which means that a file has no id. The id is not negative, so that the signed `user_version` and
    // the unsigned number in the header are equal.
    ((Uuid::new_v4().as_u128() & 0x7fff_ffff) as i32).max(1)
}

/// Refuses the write-ahead log beside a database if it belongs to another file. Has to be called before SQLite opens
/// the file.
///
/// `file` has to stay open until SQLite has closed the database (see [`DatabaseLock`](super::lock::DatabaseLock)). A
/// file of an earlier version has no id and is not checked. An error while reading is logged and not returned, because
/// SQLite reports the error when it opens the file.
pub(crate) fn refuse_foreign_log(database: &Path, file: &File) -> Result<(), ForeignLog> {
    let log = log_path(database);
    match read_id(file)
        .and_then(|database_id| database_id.map_or(Ok(false), |database_id| is_foreign(&log, database_id)))
    {
        Ok(false) => Ok(()),
        Ok(true) => Err(ForeignLog(log)),
        Err(error) => {
            tracing::warn!(%error, log = %log.display(), "cannot determine whether the write-ahead log belongs to the database; SQLite will read it");
            Ok(())
        }
    }
}

/// Does the same as [`refuse_foreign_log`] for a file that no connection of this process has open: the file is opened
/// and closed here.
pub(crate) fn refuse_foreign_log_at(database: &Path) -> Result<(), ForeignLog> {
    File::open(database).map_or(Ok(()), |file| refuse_foreign_log(database, &file))
}

/// Returns the id of a database; `None` if the file is no database or has no id.
fn read_id(file: &File) -> io::Result<Option<u32>> {
    let mut header = [0; 100];
    let is_database = read_whole(file, &mut header, 0)? && header.starts_with(b"SQLite format 3\0");
    Ok(Some(be32(&header, ID_OFFSET)).filter(|id| is_database && *id != 0))
}

/// Returns whether the write-ahead log belongs to another database. The log contains copies of page 1, and each copy
/// has an id. The log belongs to another database if, in the frames with valid checksums, at least
/// one copy has another id than `database_id`, and no copy has `database_id`.
fn is_foreign(log: &Path, database_id: u32) -> io::Result<bool> {
    let log = match File::open(log) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(false),
        log => log?,
    };
    let mut header = [0; HEADER_BYTES];
    if !read_whole(&log, &mut header, 0)? {
        return Ok(false);
    }
    let (magic, page_bytes) = (be32(&header, 0), be32(&header, 8) as usize);
    let mut checksum = Checksum { big_endian: magic & 1 == 1, words: (0, 0) };
    checksum.add(&header[..24]);
    let is_log = magic & !1 == MAGIC && page_bytes.is_power_of_two() && (512..=65_536).contains(&page_bytes);
    if !is_log || !checksum.equals_stored(&header[24..]) {
        return Ok(false);
    }
    let (mut frame, mut offset) = (vec![0; FRAME_BYTES + page_bytes], HEADER_BYTES as u64);
    let mut has_other_id = false;
    while read_whole(&log, &mut frame, offset)? {
        let (head, page) = frame.split_at(FRAME_BYTES);
        checksum.add(&head[..8]);
        checksum.add(page);
        // This frame and the frames after it were left by an earlier use of the log file (other salts), or were not
        // written completely. SQLite stops here, too.
        if head[8..16] != header[16..24] || !checksum.equals_stored(&head[16..]) {
            break;
        }
        match be32(page, ID_OFFSET) {
            // Only page 1 has an id. In a file of an earlier version, page 1 has no id.
            id if be32(head, 0) != 1 || id == 0 => {}
            id if id == database_id => return Ok(false),
            _ => has_other_id = true,
        }
        offset += frame.len() as u64;
    }
    Ok(has_other_id)
}

/// SQLite's checksum over the write-ahead log up to a frame.
struct Checksum {
    big_endian: bool,
    words: (u32, u32),
}

impl Checksum {
    fn add(&mut self, bytes: &[u8]) {
        let (mut first, mut second) = self.words;
        for pair in bytes.chunks_exact(8) {
            let (even, odd) = (be32(pair, 0), be32(pair, 4));
            let (even, odd) =
                if self.big_endian { (even, odd) } else { (even.swap_bytes(), odd.swap_bytes()) };
            first = first.wrapping_add(even).wrapping_add(second);
            second = second.wrapping_add(odd).wrapping_add(first);
        }
        self.words = (first, second);
    }

    fn equals_stored(&self, bytes: &[u8]) -> bool {
        (be32(bytes, 0), be32(bytes, 4)) == self.words
    }
}
