"""Steps of the schema, run by `soopnav_cpp.sopdb.database.migrate`."""
