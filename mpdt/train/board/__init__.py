"""The leaderboard: results of runs, studies and others' policies as rows of one CSV file."""
