"""Tune many logs into one table: `python docs/examples/folder.py FOLDER TABLE.csv`."""

import sys

import tunenet_logs as tn


def main(folder: str, table: str) -> None:
    """The results go into the folder `results`; what has one there is not tuned again."""
    ledger = tn.tune_all(f"{folder}/drop_*.mcap", "results", resume=True, reviewed="none")
    ledger.to_csv(table, index=False)
    good = ledger[ledger["verdict"] == "ok"]
    print(good[["log", "restitution", "restitution_low", "restitution_high"]].to_string())
    for row in ledger[ledger["verdict"] != "ok"].itertuples():
        print(row.log, row.verdict, row.reason, sep="  ")


if __name__ == "__main__":
    main(*sys.argv[1:])
