//! Runs of which the oldest iterations were deleted.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use axum::http::StatusCode;
use peernet_clock::{Clock, ClockIdentity, MonoTime, Span, SystemClock, WallTime};
use serde_json::json;

use crate::bed::Bed;
use crate::factory::{Factory, Line};

/// The system's clock, put forward by some seconds.
#[derive(Debug)]
struct Ahead {
    system: SystemClock,
    seconds: AtomicI64,
}

impl Clock for Ahead {
    fn wall(&self) -> WallTime {
        self.system.wall() + Span::from_seconds(self.seconds.load(Ordering::Relaxed))
    }
    fn mono(&self) -> MonoTime {
        self.system.mono()
    }
    fn identity(&self) -> &ClockIdentity {
        self.system.identity()
    }
}

#[tokio::test]
async fn what_was_deleted_is_said_and_what_remains_is_shown() {
    let system = SystemClock::new(ClockIdentity::new("rack-a", "system"));
    let clock = Arc::new(Ahead { system, seconds: AtomicI64::new(0) });
    let bed = Bed::at(clock.clone()).await;
    let mut factory = Factory::new(&bed.listening, bed.clock.clone(), vec![Line::local()]).await;
    factory.store_runs(200, true).await;
    factory.store_runs(100, true).await;
    let pinned = bed.aggregator.pin(2, true).await.expect("the database can be written");
    assert!(pinned, "run 2 is there");

    let run = async |number: i64| bed.get(&format!("/api/v1/runs/{number}")).await.json();
    assert_eq!(run(1).await["deleted_through"], json!(0));
    let deleted = async {
        while run(1).await["deleted_through"] != json!(200) {
            // A period counts from when retention first saw the run, and nothing tells of that.
            clock.seconds.fetch_add(9 * 86_400, Ordering::Relaxed);
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(60), deleted).await.expect("what is old goes");

    let page = bed.get("/runs/1").await;
    assert!(page.text().contains("Iterations 1 to 200"), "{}", page.text());
    assert!(page.text().contains("deleted after 7 days. The statistics remain."), "{}", page.text());
    assert!(page.text().contains("Distribution of total"), "its statistics are shown");
    let stages = bed.get("/api/v1/runs/1/stages").await.json();
    assert!(!stages["stages"].as_array().expect("stages").is_empty());
    let list = bed.get("/api/v1/runs/1/iterations").await.json();
    assert_eq!(list, json!({ "iterations": [], "next": null }));
    for path in ["/api/v1/runs/1/iterations/7", "/runs/1/iterations/7"] {
        let answer = bed.get(path).await;
        assert_eq!(answer.status, StatusCode::GONE, "{path}: {}", answer.text());
        assert!(answer.text().contains("iterations 1 to 200 of run 1 were deleted after 7 days"), "{path}");
    }
    assert_eq!(bed.get("/runs/1/iterations/201").await.status, StatusCode::NOT_FOUND, "that one never was");

    assert_eq!(run(2).await["deleted_through"], json!(0), "a run that is kept loses nothing");
    assert_eq!(bed.get("/runs/2/iterations/7").await.status, StatusCode::OK);
    assert!(!bed.get("/runs/2").await.text().contains("The statistics remain"));
}
