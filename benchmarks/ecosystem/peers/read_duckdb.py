"""duckdb: mean return per task and quality by SQL, from the episode table and from the steps."""

import sys

import duckdb

folder = sys.argv[1]
by_table = duckdb.sql(f"""
    SELECT task_name, quality_name, avg("return") FROM '{folder}/episodes.parquet'
    GROUP BY ALL ORDER BY ALL""").fetchall()
columns = {row[0] for row in duckdb.sql(f"DESCRIBE FROM '{folder}/data/*/*.parquet'").fetchall()}
key = next(name for name in ("episode_id", "episode_index", "episode") if name in columns)
by_steps = duckdb.sql(f"""
    WITH sums AS (SELECT {key} AS id, sum(reward::DOUBLE) AS total
                  FROM '{folder}/data/*/*.parquet' GROUP BY 1)
    SELECT task_name, quality_name, avg(total) FROM sums
    JOIN '{folder}/episodes.parquet' e ON e.{key} = sums.id
    GROUP BY ALL ORDER BY ALL""").fetchall()
assert len(by_table) == len(by_steps)
for a, b in zip(by_table, by_steps, strict=True):
    assert a[:2] == b[:2] and abs(a[2] - b[2]) <= 1e-5 * max(1, abs(a[2])), (a, b)
some = ", ".join(f"{task} {quality} {mean:.0f}" for task, quality, mean in by_table)
print(duckdb.__version__, "mean returns", some)
