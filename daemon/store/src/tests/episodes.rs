//! Episodes of a run, its warm-up, and failed iterations.

use peernet_analysis::rows::{Row, Rows};
use peernet_analysis::summary::Summary;
use peernet_analysis::warm_up::warm_up_periods;
use peernet_clock::WallTime;
use peernet_logger::RunId;
use peernet_stream::{Event, Iteration, Outcome};

use super::{TestStore, generate};
use crate::types::Episodes;

/// Sets the episode and the step of an iteration as an agent does if each episode has `steps` iterations.
fn set_episode(iteration: &mut Iteration, steps: u64) {
    let index = iteration.number - 1;
    (iteration.episode, iteration.step) = ((index / steps) as u32, (index % steps) as u32);
}

/// Stores a run of `iterations` iterations, five a second. `change` may change each iteration. An iteration for which
/// `change` returns `false` is not stored.
async fn store_run(test_store: &mut TestStore, iterations: u64, change: impl Fn(&mut Iteration) -> bool) {
    let (run, hosts, mut numbers) = (RunId::random(), test_store.hosts(), generate::Numbers::new(7));
    let mut events = vec![generate::run_started(run, "line", generate::at(0.0))];
    for number in 1..=iterations {
        let mut iteration = generate::iteration(run, number, hosts, &mut numbers);
        if change(&mut iteration) {
            events.push(Event::Iteration(iteration));
        }
    }
    let work: Vec<_> =
        events.chunks(100).map(<[Event]>::to_vec).map(|events| test_store.batch(events)).collect();
    test_store.commit(&work).await;
}

fn start_times(numbers: impl IntoIterator<Item = u64>) -> Vec<WallTime> {
    numbers.into_iter().map(|number| generate::at(number as f64 * 0.2)).collect()
}

#[tokio::test]
async fn borders_are_at_starts_of_episodes() {
    let mut test_store = TestStore::new().await;
    store_run(&mut test_store, 95, |iteration| {
        set_episode(iteration, 30);
        iteration.warm_up = iteration.number <= 30 || iteration.step == 0;
        true
    })
    .await;
    let episodes = test_store.store.episodes(1).await.expect("answers");
    let expected = Episodes {
        first: Some(generate::at(0.2)),
        count: 4,
        steps: Some(30),
        borders: start_times([31, 61, 91]),
        // Iteration 31 is warm-up, too, because it begins an episode.
        warm_up: vec![
            (generate::at(0.2), generate::at(32.0 * 0.2)),
            (generate::at(61.0 * 0.2), generate::at(62.0 * 0.2)),
            (generate::at(91.0 * 0.2), generate::at(92.0 * 0.2)),
        ],
        failed_starts: Vec::new(),
        failed_in_warm_up: Some(0),
    };
    assert_eq!(episodes, expected);
    assert_eq!(
        test_store.store.episodes(9).await.expect("answers"),
        Episodes::default(),
        "there is no such run"
    );
}

#[tokio::test]
async fn warm_up_periods_equal_those_of_rows() {
    for (case, (iterations, steps, warm_up_episodes, warm_up_steps)) in (1..).zip([
        (95, 30, 1, 1),
        (95, 30, 0, 4),
        (61, 30, 0, 2),
        (40, 10, 9, 0),
        (93, 3, 1, 1),
        (90, 30, 0, 30),
    ]) {
        let mut test_store = TestStore::new().await;
        let is_warm_up =
            |iteration: &Iteration| iteration.episode < warm_up_episodes || iteration.step < warm_up_steps;
        let starts_in_order = std::sync::Mutex::new(Vec::new());
        store_run(&mut test_store, iterations, |iteration| {
            set_episode(iteration, steps);
            iteration.warm_up = is_warm_up(iteration);
            starts_in_order
                .lock()
                .expect("not poisoned")
                .push((generate::at(iteration.number as f64 * 0.2), iteration.warm_up));
            true
        })
        .await;
        let found = test_store.store.episodes(1).await.expect("answers").warm_up;
        assert_eq!(
            found,
            warm_up_periods(starts_in_order.into_inner().expect("not poisoned")),
            "case {case}"
        );
    }
}

#[tokio::test]
async fn run_of_one_episode_has_no_border() {
    let mut test_store = TestStore::new().await;
    store_run(&mut test_store, 40, |_| true).await;
    let episodes = test_store.store.episodes(1).await.expect("answers");
    assert_eq!(
        (episodes.count, episodes.steps, episodes.borders.len(), episodes.warm_up),
        (1, None, 0, Vec::new())
    );
    // The whole run is warm-up.
    store_run(&mut test_store, 5, |iteration| {
        iteration.warm_up = true;
        true
    })
    .await;
    let whole = [(generate::at(0.2), generate::at(5.0 * 0.2))];
    assert_eq!(test_store.store.episodes(2).await.expect("answers").warm_up, whole);
}

#[tokio::test]
async fn border_of_missing_iteration_is_left_out() {
    let mut test_store = TestStore::new().await;
    store_run(&mut test_store, 95, |iteration| {
        set_episode(iteration, 30);
        ![1, 61].contains(&iteration.number)
    })
    .await;
    let episodes = test_store.store.episodes(1).await.expect("answers");
    assert_eq!((episodes.count, episodes.first, episodes.borders), (4, None, start_times([31, 91])));
}

#[tokio::test]
async fn deleted_iterations_have_no_border() {
    let mut test_store = TestStore::new().await;
    store_run(&mut test_store, 95, |iteration| {
        set_episode(iteration, 30);
        if [4, 70].contains(&iteration.number) {
            iteration.outcome = Outcome::Timeout(String::new());
        }
        true
    })
    .await;
    let episodes = test_store.store.episodes(1).await.expect("answers");
    assert_eq!((episodes.failed_starts, episodes.failed_in_warm_up), (start_times([4, 70]), Some(0)));
    let mut other = test_store.second_connection().await;
    sqlx::query("DELETE FROM iteration WHERE run = 1 AND number <= 40")
        .execute(&mut other)
        .await
        .expect("deletes");
    let episodes = test_store.store.episodes(1).await.expect("answers");
    assert_eq!((episodes.count, episodes.steps, episodes.first), (4, Some(30), None));
    assert_eq!(
        (episodes.borders, episodes.failed_starts, episodes.failed_in_warm_up),
        (start_times([61, 91]), start_times([70]), Some(0))
    );
}

#[tokio::test]
async fn inconsistent_step_numbers_have_no_border() {
    let mut test_store = TestStore::new().await;
    store_run(&mut test_store, 40, |iteration| {
        (iteration.episode, iteration.step) = (iteration.number as u32 / 10, iteration.number as u32 % 7);
        true
    })
    .await;
    let episodes = test_store.store.episodes(1).await.expect("answers");
    assert_eq!((episodes.count, episodes.steps, episodes.borders), (5, None, Vec::new()));
}

#[tokio::test]
async fn episodes_of_different_lengths_have_borders() {
    let mut test_store = TestStore::new().await;
    // Episodes of 7, 3, 12, 5, 1 and the remaining 12 iterations.
    let first_numbers = [1, 8, 11, 23, 28, 29];
    store_run(&mut test_store, 40, |iteration| {
        let episode = first_numbers.iter().rposition(|first| *first <= iteration.number).expect("at least 1");
        let step = iteration.number - first_numbers[episode];
        (iteration.episode, iteration.step) = (episode as u32, step as u32);
        true
    })
    .await;
    let episodes = test_store.store.episodes(1).await.expect("answers");
    assert_eq!(
        (episodes.count, episodes.steps, episodes.borders),
        (6, None, start_times([8, 11, 23, 28, 29]))
    );
    let mut other = test_store.second_connection().await;
    sqlx::query("DELETE FROM iteration WHERE run = 1 AND number <= 9")
        .execute(&mut other)
        .await
        .expect("deletes");
    let episodes = test_store.store.episodes(1).await.expect("answers");
    assert_eq!(episodes.borders, start_times([11, 23, 28, 29]), "the start of the second episode is deleted");
}

#[tokio::test]
async fn gap_hides_only_borders_within_it() {
    let mut test_store = TestStore::new().await;
    let first_numbers = [1, 8, 11, 23, 28, 29];
    // Number 20 is half of 40, so the search for the starts of episodes looks at it first. Number 28 is a whole episode.
    store_run(&mut test_store, 40, |iteration| {
        let episode = first_numbers.iter().rposition(|first| *first <= iteration.number).expect("at least 1");
        let step = iteration.number - first_numbers[episode];
        (iteration.episode, iteration.step) = (episode as u32, step as u32);
        iteration.warm_up = step == 0;
        ![20, 28].contains(&iteration.number)
    })
    .await;
    let episodes = test_store.store.episodes(1).await.expect("answers");
    assert_eq!(episodes.borders, start_times([8, 11, 23, 29]));
    assert_eq!(
        episodes.warm_up.iter().map(|(from, _)| *from).collect::<Vec<_>>(),
        start_times([1, 8, 11, 23, 29])
    );
}

#[tokio::test]
async fn too_many_episodes_are_only_counted() {
    let mut test_store = TestStore::new().await;
    // Runs of 31 and of 32 episodes. The first run has the maximum number of borders.
    for iterations in [93, 94] {
        store_run(&mut test_store, iterations, |iteration| {
            set_episode(iteration, 3);
            true
        })
        .await;
    }
    let episodes = test_store.store.episodes(1).await.expect("answers");
    assert_eq!(
        (episodes.count, episodes.steps, episodes.borders),
        (31, Some(3), start_times((1..=30).map(|n| n * 3 + 1)))
    );
    let episodes = test_store.store.episodes(2).await.expect("answers");
    assert_eq!((episodes.count, episodes.steps, episodes.borders), (32, Some(3), Vec::new()));
}

#[tokio::test]
async fn shown_failed_iterations_cover_whole_run() {
    let mut test_store = TestStore::new().await;
    // Up to iteration 1,200, every iteration with an even number is lost. Later, only iteration 1,990 is lost.
    store_run(&mut test_store, 2_000, |iteration| {
        let is_lost = iteration.number % 2 == 0 && iteration.number <= 1_200 || iteration.number == 1_990;
        if is_lost {
            iteration.outcome = Outcome::Lost("connection broke".into());
        }
        iteration.warm_up = iteration.number <= 100;
        true
    })
    .await;
    let episodes = test_store.store.episodes(1).await.expect("answers");
    assert_eq!(episodes.failed_in_warm_up, Some(50));
    // The first lost iteration of each of 300 parts of the run is shown. About 180 parts have a lost iteration.
    let shown = episodes.failed_starts;
    assert!((150..=Episodes::MAX_FAILED).contains(&shown.len()), "{}", shown.len());
    assert_eq!((shown[0], shown[shown.len() - 1]), (generate::at(0.4), generate::at(398.0)));
    assert!(shown.is_sorted());
}

#[tokio::test]
async fn failed_warm_up_is_counted_as_in_summary() {
    let mut test_store = TestStore::new().await;
    let rows = std::sync::Mutex::new(Vec::new());
    // Half of the iterations are warm-up, and half are lost.
    store_run(&mut test_store, 1_000, |iteration| {
        set_episode(iteration, 10);
        iteration.warm_up = iteration.step < 5;
        if iteration.number.is_multiple_of(2) {
            iteration.outcome = Outcome::Lost("connection broke".into());
        }
        rows.lock().expect("not poisoned").push(Row::from_iteration(iteration));
        true
    })
    .await;
    let rows = rows.into_inner().expect("not poisoned");
    let in_summary = |first: u64| {
        let rows: Rows = rows.iter().filter(|row| row.iteration >= first).cloned().collect();
        Some(Summary::from_rows(&rows).failed_in_warm_up)
    };
    let episodes = test_store.store.episodes(1).await.expect("answers");
    assert_eq!(episodes.failed_in_warm_up, in_summary(1));
    let mut other = test_store.second_connection().await;
    sqlx::query("DELETE FROM iteration WHERE run = 1 AND number <= 700")
        .execute(&mut other)
        .await
        .expect("deletes");
    let episodes = test_store.store.episodes(1).await.expect("answers");
    assert_eq!(episodes.failed_in_warm_up, in_summary(701), "of the stored iterations");
}

#[tokio::test]
async fn too_many_failed_iterations_are_not_counted() {
    let mut test_store = TestStore::new().await;
    store_run(&mut test_store, 1, |_| true).await;
    let mut other = test_store.second_connection().await;
    let columns = sqlx::query_scalar::<_, String>("SELECT name FROM pragma_table_info('iteration')");
    let columns = columns.fetch_all(&mut other).await.expect("the columns");
    // Stores 10,500 copies of the iteration with the outcome `failed`. At most 10,000 failed iterations are counted.
    let values = columns.iter().map(|name| match name.as_str() {
        "number" => "2 + value",
        "outcome" => "1",
        column => column,
    });
    let insert_copies = format!(
        "WITH RECURSIVE counted(value) AS (SELECT 0 UNION ALL SELECT value + 1 FROM counted WHERE value < 10499) \
         INSERT INTO iteration ({}) SELECT {} FROM iteration, counted WHERE run = 1 AND number = 1",
        columns.join(", "),
        values.collect::<Vec<_>>().join(", ")
    );
    sqlx::query(sqlx::AssertSqlSafe(insert_copies)).execute(&mut other).await.expect("inserts");
    let episodes = test_store.store.episodes(1).await.expect("answers");
    assert_eq!(episodes.failed_in_warm_up, None);
    assert!(episodes.failed_starts.len() <= Episodes::MAX_FAILED);
}
