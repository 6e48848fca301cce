//! Multi-row inserts: the fast path into SQLite.

use std::sync::Arc;

use sqlx::error::BoxDynError;
use sqlx::sqlite::SqliteArguments;
use sqlx::{Arguments, AssertSqlSafe, SqliteConnection};

/// Rows of one statement, largest first. Few sizes, so that every statement stays prepared; the largest stays
/// under SQLite's 32,766 parameters for up to 31 columns.
const SIZES: [usize; 5] = [1024, 256, 32, 4, 1];

/// One table's insert statement in all sizes.
#[derive(Debug)]
pub(crate) struct Insert {
    statements: [Arc<str>; SIZES.len()],
    columns: usize,
}

impl Insert {
    /// Inserts rows of `columns` columns: `head (?, …), (?, …) tail`.
    pub(crate) fn new(head: &str, columns: usize, tail: &str) -> Self {
        let row = format!("({})", vec!["?"; columns].join(","));
        let statements = SIZES
            .map(|rows| Arc::from(format!("{head} VALUES {} {tail}", vec![row.as_str(); rows].join(","))));
        Self { statements, columns }
    }

    /// Inserts all rows; `bind` adds one row's values in the order of the columns.
    ///
    /// SQLite works on a thread of its own: while it executes one statement, the next one's values are bound.
    pub(crate) async fn run<R>(
        &self,
        connection: &mut SqliteConnection,
        rows: &[R],
        bind: impl Fn(&R, &mut SqliteArguments) -> Result<(), BoxDynError>,
    ) -> Result<(), sqlx::Error> {
        let collect = |rows: &[R]| -> Result<SqliteArguments, sqlx::Error> {
            let mut arguments = SqliteArguments::default();
            arguments.reserve(rows.len() * self.columns, 0);
            rows.iter().try_for_each(|row| bind(row, &mut arguments)).map_err(sqlx::Error::Encode)?;
            Ok(arguments)
        };
        let mut chunks = self.chunks(rows);
        let Some((mut statement, first)) = chunks.next() else { return Ok(()) };
        let mut arguments = collect(first)?;
        loop {
            let query = sqlx::query_with(AssertSqlSafe(Arc::clone(statement)), arguments);
            let next = async { chunks.next().map(|(statement, rows)| (statement, collect(rows))) };
            let (executed, next) = tokio::join!(biased; query.execute(&mut *connection), next);
            executed?;
            match next {
                Some((following, bound)) => (statement, arguments) = (following, bound?),
                None => return Ok(()),
            }
        }
    }

    /// Cuts rows to the sizes of the statements.
    fn chunks<'a, R>(&'a self, rows: &'a [R]) -> impl Iterator<Item = (&'a Arc<str>, &'a [R])> {
        let mut rest = rows;
        SIZES.into_iter().zip(&self.statements).flat_map(move |(size, statement)| {
            let (now, later) = rest.split_at(rest.len() - rest.len() % size);
            rest = later;
            now.chunks(size).map(move |rows| (statement, rows))
        })
    }
}

#[cfg(test)]
mod tests {
    use sqlx::Connection;

    use super::*;

    #[tokio::test]
    async fn every_number_of_rows_arrives_whole_and_in_order() {
        let mut connection = SqliteConnection::connect("sqlite::memory:").await.expect("opens");
        sqlx::raw_sql("CREATE TABLE t (a INTEGER PRIMARY KEY, b TEXT)")
            .execute(&mut connection)
            .await
            .expect("makes");
        let insert = Insert::new("INSERT INTO t", 2, "");
        let mut next = 0_i64;
        for count in [0, 1, 3, 5, 31, 1023, 1024, 1025, 2500] {
            let rows: Vec<i64> = (next..next + count).collect();
            next += count;
            insert
                .run(&mut connection, &rows, |row, arguments| {
                    arguments.add(*row)?;
                    arguments.add(row.to_string())
                })
                .await
                .expect("inserts");
        }
        let (count, wrong): (i64, i64) =
            sqlx::query_as("SELECT count(*), count(*) FILTER (WHERE b <> CAST(a AS TEXT)) FROM t")
                .fetch_one(&mut connection)
                .await
                .expect("reads");
        assert_eq!((count, wrong), (next, 0));
    }
}
