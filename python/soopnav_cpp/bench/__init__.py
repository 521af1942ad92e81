"""Speed beside named peers, turn by turn in the same run: what ``soopnav bench`` runs.

======================  ===========================================================
`harness`               a case, its peers, the turns, the row
`cases`                 our side of each case, and who its peers are
`systems`               the data that all sides of a case get
`peers`                 the other side: one module per package, which needs nothing of soopnav
`environments`          a virtual environment for a peer that cannot live in this one
`worker`                runs there, and speaks JSON lines
======================  ===========================================================

Importing this package needs no peer; a peer that is not installed is named in the result.
"""
