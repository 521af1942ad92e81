"""The shared database of signals of opportunity: who stands where, whose clock runs how, and how sure that is.

======================  ===========================================================
`soopnav_cpp.sopdb.records`   what a characterisation may say
`soopnav_cpp.sopdb.fusion`    many characterisations of a source made one, at any time
`soopnav_cpp.sopdb.snapshot`  the file to work from without a network
`soopnav_cpp.sopdb.client`    asks and contributes over the network
`soopnav_cpp.sopdb.service`   answers over the network
======================  ===========================================================

Imported by itself, with the extra ``sopdb``.
"""
