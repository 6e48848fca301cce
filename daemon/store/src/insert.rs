//! Multi-row statements: the fastest way to insert rows into SQLite.

use std::sync::Arc;

use futures::future::BoxFuture;
use sqlx::error::BoxDynError;
use sqlx::sqlite::SqliteArguments;
use sqlx::{Arguments, AssertSqlSafe, SqliteConnection};

/// Numbers of rows per statement, largest first. There are few sizes, so that every statement stays prepared. With up
/// to 31 columns, the largest statement has at most 31,744 parameters; SQLite allows 32,766.
const SIZES: [usize; 5] = [1024, 256, 32, 4, 1];

/// Statements that insert rows into one table: one statement for each number of rows in [`SIZES`].
#[derive(Debug)]
pub(crate) struct Insert {
    statements: [Arc<str>; SIZES.len()],
    columns: usize,
}

impl Insert {
    /// Makes the statements `head VALUES (?, …), (?, …) tail` for rows of `columns` columns.
    pub(crate) fn new(head: &str, columns: usize, tail: &str) -> Self {
        let row = format!("({})", vec!["?"; columns].join(","));
        let statements = SIZES
            .map(|rows| Arc::from(format!("{head} VALUES {} {tail}", vec![row.as_str(); rows].join(","))));
        Self { statements, columns }
    }

    /// Inserts all rows; `bind` adds one row's values in the order of the columns.
    ///
    /// SQLite works on a separate thread: while SQLite executes a statement, the values of the next statement are
    /// bound.
    pub(crate) fn run<'a, R: 'a>(
        &'a self,
        connection: &'a mut SqliteConnection,
        rows: impl IntoIterator<Item = R, IntoIter: ExactSizeIterator + Send + 'a>,
        mut bind: impl FnMut(R, &mut SqliteArguments) -> Result<(), BoxDynError> + Send + 'a,
    ) -> BoxFuture<'a, Result<(), sqlx::Error>> {
        let mut rows = rows.into_iter();
        let mut next = move || -> Result<Option<(&'a Arc<str>, SqliteArguments)>, sqlx::Error> {
            let remaining_rows = rows.len();
            let Some(size) = SIZES.iter().position(|size| *size <= remaining_rows) else { return Ok(None) };
            let mut arguments = SqliteArguments::default();
            arguments.reserve(SIZES[size] * self.columns, 0);
            rows.by_ref()
                .take(SIZES[size])
                .try_for_each(|row| bind(row, &mut arguments))
                .map_err(sqlx::Error::Encode)?;
            Ok(Some((&self.statements[size], arguments)))
        };
        Box::pin(async move {
            let mut current = next()?;
            while let Some((statement, arguments)) = current {
                let query = sqlx::query_with(AssertSqlSafe(Arc::clone(statement)), arguments);
                let (executed, following) =
                    // The query is polled first, so that SQLite's thread has work while the next values are
                    // bound.
                    tokio::join!(biased; query.execute(&mut *connection), async { next() });
                executed?;
                current = following?;
            }
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use sqlx::Connection;

    use super::*;

    #[tokio::test]
    async fn any_number_of_rows_is_inserted_in_order() {
        let mut connection = SqliteConnection::connect("sqlite::memory:").await.expect("opens");
        sqlx::raw_sql("CREATE TABLE t (a INTEGER PRIMARY KEY, b TEXT)")
            .execute(&mut connection)
            .await
            .expect("makes");
        let insert = Insert::new("INSERT INTO t", 2, "");
        let mut inserted = 0_i64;
        for count in [0, 1, 3, 5, 31, 1023, 1024, 1025, 2500] {
            let rows: Vec<i64> = (inserted..inserted + count).collect();
            inserted += count;
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
        assert_eq!((count, wrong), (inserted, 0));
    }
}
